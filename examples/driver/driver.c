/* A sensor in C: publishes what sal_height needs to make heights.
 *
 * It stands for a lidar with 8 detectors that flies at 50 m/s, 5 km from a row of posts, whose tops are HEIGHT above the
 * ground. Every dwell sees the top of one post, abeam of the platform, and nothing else. A driver of a real sensor puts
 * its own samples and its own platform's states in these places.
 *
 *     driver [HEIGHT in metres] [--ros-args ...]
 */
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <nav_msgs/msg/odometry.h>
#include <rcl/error_handling.h>
#include <rcl/rcl.h>
#include <rosidl_runtime_c/primitives_sequence_functions.h>
#include <rosidl_runtime_c/string_functions.h>
#include <sal_height_msgs/msg/channel_frame.h>
#include <sal_height_msgs/msg/sensor_info.h>

static const double PI = 3.14159265358979323846;
static const double LIGHT = 299792458.0; /* m/s */

enum { DETECTORS = 8, PULSES = 48, SAMPLES = 64 };
static const double WAVELENGTH = 1.55e-6, APERTURE = 0.01, BANDWIDTH = 2e9, PULSE_RATE = 30e3; /* m, m, Hz, Hz */
static const double SPEED = 50.0, RANGE = 5000.0, LOOK_ANGLE = 0.25 * 3.14159265358979323846;  /* m/s, m, rad */
static const double AMPLITUDE = 10.0; /* of an echo in the middle of a beam; the receivers' noise is 1 */

static const double ODOMETRY_PERIOD = 0.01; /* s */
enum { STATES_PER_DWELL = 20 };

static const char CONFIG[] = "posts 1"; /* any text that changes when a value of the description does */

static volatile sig_atomic_t ending = 0;

static void end(int signal) { (void)signal, ending = 1; }

static void check(int success, const char * what) {
  if (success) return;
  fprintf(stderr, "driver: %s: %s\n", what, rcl_get_error_string().str);
  exit(EXIT_FAILURE);
}

static builtin_interfaces__msg__Time stamp_of(int64_t ns) {
  return (builtin_interfaces__msg__Time){.sec = (int32_t)(ns / 1000000000), .nanosec = (uint32_t)(ns % 1000000000)};
}

static void set_text(rosidl_runtime_c__String * field, const char * text) {
  check(rosidl_runtime_c__String__assign(field, text), "memory");
}

static void set_count(rosidl_runtime_c__double__Sequence * field, size_t count) {
  check(rosidl_runtime_c__double__Sequence__init(field, count), "memory");
}

static void set_zeros(rosidl_runtime_c__double__Sequence * field, size_t count) {
  set_count(field, count);
  memset(field->data, 0, count * sizeof *field->data);
}

/* Where a detector looks: from nadir towards the right, half a beamwidth from the next. */
static double boresight(int detector) {
  return LOOK_ANGLE + (detector - 0.5 * (DETECTORS - 1)) * 0.5 * WAVELENGTH / APERTURE;
}

/* Amplitude of the beam of a circular aperture ("jinc"), at an angle from its boresight. */
static double beam(double angle) {
  double x = PI * angle * APERTURE / WAVELENGTH;
  return fabs(x) < 1e-6 ? 1.0 : 2.0 * j1(x) / x;
}

/* What never changes: the sensor. */
static void describe(sal_height_msgs__msg__SensorInfo * info) {
  check(sal_height_msgs__msg__SensorInfo__init(info), "memory");
  info->contract_version = sal_height_msgs__msg__SensorInfo__CONTRACT_VERSION;
  set_text(&info->header.frame_id, "base_link");
  set_text(&info->name, "posts");
  set_text(&info->config_hash, CONFIG);
  set_text(&info->mode, sal_height_msgs__msg__SensorInfo__SPOTLIGHT);
  info->look_side = sal_height_msgs__msg__SensorInfo__RIGHT;
  info->pulse_count = PULSES;
  info->pulse_repetition_frequency = PULSE_RATE;

  set_text(&info->waveform.kind, sal_height_msgs__msg__Waveform__SPECTRUM);
  info->waveform.wavelength = WAVELENGTH;
  info->waveform.bandwidth = BANDWIDTH;
  info->waveform.sample_count = SAMPLES;

  set_text(&info->beams.pattern, sal_height_msgs__msg__BeamModel__JINC);
  info->beams.elevation_diameter = info->beams.azimuth_diameter = APERTURE;
  set_count(&info->beams.elevation_boresights, DETECTORS);
  set_count(&info->channels.noise_power, DETECTORS);
  for (int detector = 0; detector < DETECTORS; detector++) {
    info->beams.elevation_boresights.data[detector] = boresight(detector);
    info->channels.noise_power.data[detector] = 1.0;
  }
  set_text(&info->mounting.frame_id, "sensor"); /* in the origin of base_link, and not turned: w of the rotation is 1 */

  /* Standard deviations of all this: exact, as the echoes below. What stays empty is unknown. */
  set_zeros(&info->mounting.lever_arm_covariance, 9);
  set_zeros(&info->mounting.rotation_covariance, 9);
  set_zeros(&info->uncertainty.range_delay, 1);
  set_zeros(&info->uncertainty.sample_clock, 1);
  set_zeros(&info->uncertainty.odometry_delay, 1);
  set_zeros(&info->uncertainty.beam_pitch, 1);
  set_zeros(&info->uncertainty.beam_width, 1);
  set_zeros(&info->uncertainty.channel_gain, 1);
}

/* The platform, s after the first state: on a line to the east, level, so that the ground abeam is at RANGE. */
static void set_state(nav_msgs__msg__Odometry * odometry, int64_t ns, double seconds) {
  odometry->header.stamp = stamp_of(ns);
  odometry->pose.pose.position.x = SPEED * seconds;
  odometry->pose.pose.position.y = RANGE * sin(LOOK_ANGLE);
  odometry->pose.pose.position.z = RANGE * cos(LOOK_ANGLE);
  odometry->twist.twist.linear.x = SPEED; /* in the axes of base_link */
}

/* Samples of a detector: the echo of a post abeam of the middle of the dwell, HEIGHT above the ground. */
static void receive(sal_height_msgs__msg__ChannelFrame * frame, int detector, double height) {
  float * sample = (float *)frame->samples.data;
  double across = RANGE * sin(LOOK_ANGLE), down = RANGE * cos(LOOK_ANGLE) - height;
  double amplitude = AMPLITUDE * beam(atan2(across, down) - boresight(detector));
  for (int pulse = 0; pulse < PULSES; pulse++) {
    double along = SPEED * (pulse - 0.5 * (PULSES - 1)) / PULSE_RATE;
    double way = sqrt(along * along + across * across + down * down) - RANGE;
    for (int k = 0; k < SAMPLES; k++) {
      double frequency = LIGHT / WAVELENGTH + (k - 0.5 * (SAMPLES - 1)) * BANDWIDTH / SAMPLES;
      double phase = -4.0 * PI * fmod(frequency * way / LIGHT, 1.0);
      *sample++ = (float)(amplitude * cos(phase));
      *sample++ = (float)(amplitude * sin(phase));
    }
  }
}

static rcl_publisher_t publisher(const rcl_node_t * node, const rosidl_message_type_support_t * type, const char * topic,
                                 size_t depth, int latched) {
  rcl_publisher_t made = rcl_get_zero_initialized_publisher();
  rcl_publisher_options_t options = rcl_publisher_get_default_options();
  options.qos.reliability = RMW_QOS_POLICY_RELIABILITY_RELIABLE;
  options.qos.history = RMW_QOS_POLICY_HISTORY_KEEP_LAST;
  options.qos.depth = depth;
  options.qos.durability = latched ? RMW_QOS_POLICY_DURABILITY_TRANSIENT_LOCAL : RMW_QOS_POLICY_DURABILITY_VOLATILE;
  check(rcl_publisher_init(&made, node, type, topic, &options) == RCL_RET_OK, topic);
  return made;
}

int main(int argc, char ** argv) {
  double height = argc > 1 && argv[1][0] != '-' ? atof(argv[1]) : 0.0;
  signal(SIGINT, end);
  signal(SIGTERM, end);

  rcl_allocator_t allocator = rcl_get_default_allocator();
  rcl_init_options_t options = rcl_get_zero_initialized_init_options();
  rcl_context_t context = rcl_get_zero_initialized_context();
  rcl_node_t node = rcl_get_zero_initialized_node();
  rcl_node_options_t node_options = rcl_node_get_default_options();
  check(rcl_init_options_init(&options, allocator) == RCL_RET_OK, "options");
  check(rcl_init(argc, (const char * const *)argv, &options, &context) == RCL_RET_OK, "start");
  check(rcl_node_init(&node, "driver", "", &context, &node_options) == RCL_RET_OK, "node");
  rcl_publisher_t infos =
    publisher(&node, ROSIDL_GET_MSG_TYPE_SUPPORT(sal_height_msgs, msg, SensorInfo), "sensor_info", 1, 1);
  rcl_publisher_t states =
    publisher(&node, ROSIDL_GET_MSG_TYPE_SUPPORT(nav_msgs, msg, Odometry), "platform/odometry", 1000, 0);
  rcl_publisher_t frames =
    publisher(&node, ROSIDL_GET_MSG_TYPE_SUPPORT(sal_height_msgs, msg, ChannelFrame), "phase_history", 256, 0);

  /* Zero first: what init knows no default of it leaves as it is. */
  sal_height_msgs__msg__SensorInfo info = {0};
  describe(&info);
  check(rcl_publish(&infos, &info, NULL) == RCL_RET_OK, "sensor_info");

  nav_msgs__msg__Odometry state = {0};
  check(nav_msgs__msg__Odometry__init(&state), "memory"); /* level, to the east: w of the orientation is 1 */
  set_text(&state.header.frame_id, "map");
  set_text(&state.child_frame_id, "base_link");

  sal_height_msgs__msg__ChannelFrame frame = {0};
  check(sal_height_msgs__msg__ChannelFrame__init(&frame), "memory");
  set_text(&frame.header.frame_id, "sensor");
  set_text(&frame.config_hash, CONFIG);
  set_text(&frame.encoding, sal_height_msgs__msg__ChannelFrame__COMPLEX_FLOAT32);
  frame.pulse_count = PULSES;
  frame.sample_count = SAMPLES;
  set_count(&frame.pulse_time, PULSES);
  set_count(&frame.reference_range, PULSES);
  for (int pulse = 0; pulse < PULSES; pulse++) {
    frame.pulse_time.data[pulse] = pulse / PULSE_RATE;
    frame.reference_range.data[pulse] = RANGE;
  }
  check(rosidl_runtime_c__uint8__Sequence__init(&frame.samples, PULSES * SAMPLES * 2 * sizeof(float)), "memory");

  struct timespec now, period = {.tv_nsec = (long)(1e9 * ODOMETRY_PERIOD)};
  clock_gettime(CLOCK_REALTIME, &now);
  int64_t start_ns = now.tv_sec * 1000000000LL + now.tv_nsec, period_ns = period.tv_nsec;
  for (int64_t step = 0; !ending; step++) {
    int64_t ns = start_ns + step * period_ns;
    set_state(&state, ns, 1e-9 * (double)(ns - start_ns));
    check(rcl_publish(&states, &state, NULL) == RCL_RET_OK, "platform/odometry");
    if (step % STATES_PER_DWELL == 1) { /* a dwell has been taken between the last state and this one */
      frame.header.stamp = stamp_of(ns - period_ns / 2);
      frame.dwell = (uint32_t)(step / STATES_PER_DWELL);
      for (int detector = 0; detector < DETECTORS; detector++) {
        frame.channel = (uint32_t)detector;
        receive(&frame, detector, height);
        check(rcl_publish(&frames, &frame, NULL) == RCL_RET_OK, "phase_history");
      }
    }
    nanosleep(&period, NULL);
  }

  sal_height_msgs__msg__ChannelFrame__fini(&frame);
  nav_msgs__msg__Odometry__fini(&state);
  sal_height_msgs__msg__SensorInfo__fini(&info);
  check(rcl_publisher_fini(&frames, &node) == RCL_RET_OK, "end");
  check(rcl_publisher_fini(&states, &node) == RCL_RET_OK, "end");
  check(rcl_publisher_fini(&infos, &node) == RCL_RET_OK, "end");
  check(rcl_node_fini(&node) == RCL_RET_OK, "end");
  check(rcl_shutdown(&context) == RCL_RET_OK, "end");
  check(rcl_context_fini(&context) == RCL_RET_OK, "end");
  check(rcl_init_options_fini(&options) == RCL_RET_OK, "end");
  return EXIT_SUCCESS;
}
