"""Texts and hashes of the message types that the package reads and writes; made by tools/definitions.py."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

TEXTS: Mapping[str, str] = MappingProxyType(
    {
        "builtin_interfaces/msg/Time": r"""# This message communicates ROS Time defined here:
# https://design.ros2.org/articles/clock_and_time.html

# The seconds component, valid over all int32 values.
int32 sec

# The nanoseconds component, valid in the range [0, 1e9), to be added to the seconds component. 
# e.g.
# The time -1.7 seconds is represented as {sec: -2, nanosec: 3e8}
# The time 1.7 seconds is represented as {sec: 1, nanosec: 7e8}
uint32 nanosec
""",
        "diagnostic_msgs/msg/DiagnosticArray": r"""# This message is used to send diagnostic information about the state of the robot.
std_msgs/Header header # for timestamp
DiagnosticStatus[] status # an array of components being reported on
""",
        "diagnostic_msgs/msg/DiagnosticStatus": r"""# This message holds the status of an individual component of the robot.

# Possible levels of operations.
byte OK=0
byte WARN=1
byte ERROR=2
byte STALE=3

# Level of operation enumerated above.
byte level
# A description of the test/component reporting.
string name
# A description of the status.
string message
# A hardware unique string.
string hardware_id
# An array of values associated with the status.
KeyValue[] values

""",
        "diagnostic_msgs/msg/KeyValue": r"""# What to label this value when viewing.
string key
# A value to track over time.
string value
""",
        "geometry_msgs/msg/Point": r"""# This contains the position of a point in free space
float64 x
float64 y
float64 z
""",
        "geometry_msgs/msg/Pose": r"""# A representation of pose in free space, composed of position and orientation.

Point position
Quaternion orientation
""",
        "geometry_msgs/msg/PoseStamped": r"""# A Pose with reference coordinate frame and timestamp

std_msgs/Header header
Pose pose
""",
        "geometry_msgs/msg/PoseWithCovariance": r"""# This represents a pose in free space with uncertainty.

Pose pose

# Row-major representation of the 6x6 covariance matrix
# The orientation parameters use a fixed-axis representation.
# In order, the parameters are:
# (x, y, z, rotation about X axis, rotation about Y axis, rotation about Z axis)
float64[36] covariance
""",
        "geometry_msgs/msg/PoseWithCovarianceStamped": r"""# This expresses an estimated pose with a reference coordinate frame and timestamp

std_msgs/Header header
PoseWithCovariance pose
""",
        "geometry_msgs/msg/Quaternion": r"""# This represents an orientation in free space in quaternion form.

float64 x 0
float64 y 0
float64 z 0
float64 w 1
""",
        "geometry_msgs/msg/Transform": r"""# This represents the transform between two coordinate frames in free space.

Vector3 translation
Quaternion rotation
""",
        "geometry_msgs/msg/TransformStamped": r"""# This expresses a transform from coordinate frame header.frame_id
# to the coordinate frame child_frame_id at the time of header.stamp
#
# This message is mostly used by the
# <a href="https://docs.ros.org/en/rolling/p/tf2/">tf2</a> package.
# See its documentation for more information.
#
# The child_frame_id is necessary in addition to the frame_id
# in the Header to communicate the full reference for the transform
# in a self contained message.

# The frame id in the header is used as the reference frame of this transform.
std_msgs/Header header

# The frame id of the child frame to which this transform points.
string child_frame_id

# Translation and rotation in 3-dimensions of child_frame_id from header.frame_id.
Transform transform
""",
        "geometry_msgs/msg/Twist": r"""# This expresses velocity in free space broken into its linear and angular parts.

Vector3  linear
Vector3  angular
""",
        "geometry_msgs/msg/TwistStamped": r"""# A twist with reference coordinate frame and timestamp

std_msgs/Header header
Twist twist
""",
        "geometry_msgs/msg/TwistWithCovariance": r"""# This expresses velocity in free space with uncertainty.

Twist twist

# Row-major representation of the 6x6 covariance matrix
# The orientation parameters use a fixed-axis representation.
# In order, the parameters are:
# (x, y, z, rotation about X axis, rotation about Y axis, rotation about Z axis)
float64[36] covariance
""",
        "geometry_msgs/msg/Vector3": r"""# This represents a vector in free space.

# This is semantically different than a point.
# A vector is always anchored at the origin.
# When a transform is applied to a vector, only the rotational component is applied.

float64 x
float64 y
float64 z
""",
        "nav_msgs/msg/Odometry": r"""# This represents an estimate of a position and velocity in free space.
# The pose in this message should be specified in the coordinate frame given by header.frame_id
# The twist in this message should be specified in the coordinate frame given by the child_frame_id

# Includes the frame id of the pose parent.
std_msgs/Header header

# Frame id the pose points to. The twist is in this coordinate frame.
string child_frame_id

# Estimated pose that is typically relative to a fixed world frame.
geometry_msgs/PoseWithCovariance pose

# Estimated linear and angular velocity relative to child_frame_id.
geometry_msgs/TwistWithCovariance twist
""",
        "rcl_interfaces/msg/Parameter": r"""# This is the message to communicate a parameter. It is an open struct with an enum in
# the descriptor to select which value is active.

# The full name of the parameter.
string name

# The parameter's value which can be one of several types, see
# `ParameterValue.msg` and `ParameterType.msg`.
ParameterValue value
""",
        "rcl_interfaces/msg/ParameterEvent": r"""# This message contains a parameter event.
# Because the parameter event was an atomic update, a specific parameter name
# can only be in one of the three sets.

# The time stamp when this parameter event occurred.
builtin_interfaces/Time stamp

# Fully qualified ROS path to node.
string node

# New parameters that have been set for this node.
Parameter[] new_parameters

# Parameters that have been changed during this event.
Parameter[] changed_parameters

# Parameters that have been deleted during this event.
Parameter[] deleted_parameters
""",
        "rcl_interfaces/msg/ParameterType": r"""# These types correspond to the value that is set in the ParameterValue message.

# Default value, which implies this is not a valid parameter.
uint8 PARAMETER_NOT_SET=0

uint8 PARAMETER_BOOL=1
uint8 PARAMETER_INTEGER=2
uint8 PARAMETER_DOUBLE=3
uint8 PARAMETER_STRING=4
uint8 PARAMETER_BYTE_ARRAY=5
uint8 PARAMETER_BOOL_ARRAY=6
uint8 PARAMETER_INTEGER_ARRAY=7
uint8 PARAMETER_DOUBLE_ARRAY=8
uint8 PARAMETER_STRING_ARRAY=9
""",
        "rcl_interfaces/msg/ParameterValue": r"""# Used to determine which of the next *_value fields are set.
# ParameterType.PARAMETER_NOT_SET indicates that the parameter was not set
# (if gotten) or is uninitialized.
# Values are enumerated in `ParameterType.msg`.

# The type of this parameter, which corresponds to the appropriate field below.
uint8 type

# "Variant" style storage of the parameter value. Only the value corresponding
# the type field will have valid information.

# Boolean value, can be either true or false.
bool bool_value

# Integer value ranging from -9,223,372,036,854,775,808 to
# 9,223,372,036,854,775,807.
int64 integer_value

# A double precision floating point value following IEEE 754.
float64 double_value

# A textual value with no practical length limit.
string string_value

# An array of bytes, used for non-textual information.
byte[] byte_array_value

# An array of boolean values.
bool[] bool_array_value

# An array of 64-bit integer values.
int64[] integer_array_value

# An array of 64-bit floating point values.
float64[] double_array_value

# An array of string values.
string[] string_array_value
""",
        "rosgraph_msgs/msg/Clock": r"""# This message communicates the current time.
#
# For more information, see https://design.ros2.org/articles/clock_and_time.html.
builtin_interfaces/Time clock
""",
        "sal_height_msgs/msg/Aperture": r"""# State of the sensor in the middle of the synthetic aperture, in the frame of the message's header (ENU "map").

# Pose of the sensor frame in map: the antenna's position [m] and the orientation [unit quaternion] of its axes, which are
# those of base_link if SensorInfo.mounting has no rotation. The mounting is applied already.
geometry_msgs/Pose pose

# Covariance of the pose as in nav_msgs/Odometry, 36 numbers (x, y, z [m^2], rotation about x, y, z [rad^2]). Empty: not
# known; zeros: exact.
float64[] pose_covariance

# Velocity of the antenna in map axes [m/s].
geometry_msgs/Vector3 velocity

# Covariance of the velocity in map axes [m^2/s^2], 9 numbers, row-major. Empty: not known; zeros: exact.
float64[] velocity_covariance

# Length of the synthetic aperture [m], from its first pulse to one pulse spacing past its last.
float64 length

# True in stripmap images: the aperture slides along the flight with the columns, so that every column is seen from
# abeam; the pose above is that of the middle column. False in spotlight images: all columns share the pose.
bool sliding
""",
        "sal_height_msgs/msg/BeamModel": r"""# Receive beams of a detector array behind one antenna.

# Values of pattern.
string GAUSSIAN = "gaussian"
string SINC = "sinc"              # square aperture
string JINC = "jinc"              # circular aperture
string TABLE = "table"            # measured, see tables

# Diameter of the receive antenna [m] along the detector axis (elevation) and beside it (azimuth). One beamwidth is
# wavelength / diameter [rad], in each of the two directions its own.
float64 elevation_diameter
float64 azimuth_diameter

# Amplitude pattern of one detector's beam: one of the constants above.
string pattern

# Elevation boresight of every detector [rad]: angle from nadir in the sensor frame, towards look_side, in strictly
# increasing order. Their number is the number of detectors and of channels.
float64[] elevation_boresights

# Width of every detector along the detector axis and beside it [beamwidths]; 0: a point.
float64[2] detector_size

# Rotation of the detector axis in the plane across the line of sight [rad], through the middle of the array: from growing
# elevation towards the direction of flight. Boresights are then angles along that axis, and the antenna turns with it.
float64 detector_rotation

# With pattern "table", the measured beam of every detector, or a single one for all; empty otherwise.
BeamTable[] tables
""",
        "sal_height_msgs/msg/BeamTable": r"""# Measured beam of one detector: complex amplitudes on a grid of angles from its boresight.

# Offsets from the boresight along the detector axis [rad], in strictly increasing order; 4 or more.
float64[] elevation

# Offsets from the boresight beside the detector axis, positive where a target ahead lies with no rotation [rad], in
# strictly increasing order; 4 or more, or a single one: the beam is then taken to depend on elevation only.
float64[] azimuth

# Complex amplitude, real and imaginary part in turn, row-major [elevation][azimuth]; all finite. The unit is that of all
# detectors of the sensor. Outside the grid nothing is received.
float64[] amplitude
""",
        "sal_height_msgs/msg/Calibration": r"""# What was measured of a sensor, relative to what its SensorInfo says. Latched (transient local): the last one reaches
# late subscribers. Whoever applies it to a product says so by the id in its Provenance.

# stamp: that of the last dwell it was made of. frame_id: "base_link".
std_msgs/Header header

# Identity of this calibration: any text that its maker never gives to another one, such as a UUID. Receivers do not
# interpret it.
string id

# SensorInfo.config_hash of the sensor.
string config_hash

# Number of dwells it was made of.
uint32 dwells

# Complex response of each channel's receiver, gain included, at the fast-time frequencies of waveform "spectrum"; 1: as
# described. Real and imaginary part in turn, row-major [channel][frequency], 2 * channels * frequencies numbers; all
# finite.
uint32 channels
uint32 frequencies
float64[] response

# Standard error of the shape of each channel's response over the band, at one frequency; NaN: not measured. One entry per
# channel, as in the next two fields.
float64[] response_sigma

# Standard errors of the gain of each channel: of ln |gain|, and of its phase [rad]; NaN: not measured.
float64[] gain_sigma
float64[] phase_sigma

# Width of all detectors' beams divided by that in SensorInfo (1 if it was not measured), and its standard error; NaN: the
# width was not measured.
float64 width_factor
float64 width_sigma

# Aberrations of the pupil that all detectors share, of a circular aperture: Zernike terms of its phase (defocus,
# astigmatism, oblique astigmatism, coma along the detector axis, coma beside it, spherical; each in waves rms), and their
# standard errors. Empty: not measured, and as in SensorInfo.
float64[] pupil
float64[] pupil_sigma

# How beams with this pupil fit the pixels it was measured from: power that one scatterer leaves in a pixel over that of
# the noise, and the probability of so much or more if they are right. No meaning where pupil is empty.
float64 pupil_misfit
float64 pupil_p_value

# What could not be determined, one sentence each: why, and what would be needed.
string[] undetermined
""",
        "sal_height_msgs/msg/ChannelFrame": r"""# Complex phase history of one channel in one dwell. SensorInfo.waveform states what the samples of a pulse are, with R
# the distance of a point of amplitude A from the antenna, tau = 2 R / c its delay, tau_r = 2 reference_range / c:
#
# "spectrum"  A exp(-j 4 pi f (R - reference_range) / c) at fast-time frequency f: deramped or matched-filtered,
#             residual video phase removed.
# "chirp"     A s(t - tau) exp(-j 2 pi f_c (tau - tau_r)) at time t = tau_r + (n - (N - 1) / 2) / sampling_rate, with
#             s(t) = exp(j pi chirp_rate t^2) for |t| <= pulse_duration / 2 and f_c = c / wavelength.
# "deramped"  A exp(-j 2 pi chirp_rate (tau - tau_r) (t - tau_r)) exp(-j 2 pi f_c (tau - tau_r))
#             exp(j pi chirp_rate (tau - tau_r)^2) at the same times, while the echo lasts: |t - tau| <=
#             pulse_duration / 2.

# Values of encoding: how samples are stored, real and imaginary part in turn, little endian.
string COMPLEX_FLOAT32 = "complex_float32"     # two IEEE 754 single-precision numbers (8 bytes) per sample
string COMPLEX_INT16 = "complex_int16"         # two signed 16-bit integers (4 bytes) per sample, times scale

# stamp: time of the first pulse. frame_id: that of the sensor (SensorInfo.mounting).
std_msgs/Header header

# Dwell (one spotlight collection, or one stripmap block) this frame belongs to; the same number in all its channels.
uint32 dwell

# Number of the channel, from 0: row of SensorInfo.channels.matrix; without a matrix, index of the detector in
# SensorInfo.beams.elevation_boresights.
uint32 channel

# SensorInfo.config_hash of the description these samples were taken with.
string config_hash

# Shape of samples.
uint32 pulse_count
uint32 sample_count

# Time of every pulse [s] after header.stamp; not decreasing; pulse_count entries, all finite.
float64[] pulse_time

# Range [m] to which each pulse's phase refers (motion compensation to a point in the receiver); pulse_count entries, all
# finite.
float64[] reference_range

# One of the constants above.
string encoding

# Unit of the receiver per integer step of "complex_int16", finite and greater than 0; not used by "complex_float32".
float64 scale

# Bytes of the complex samples in the encoding above, row-major [pulse][sample]; all samples finite.
uint8[] samples
""",
        "sal_height_msgs/msg/ChannelModel": r"""# What the channels of a sensor are made of, and the noise in them.

# channel = sum over detectors of matrix * detector's signal, where the detector's signal is what a beam of the pattern
# and the boresight delivers. Real and imaginary part in turn, row-major [channel][detector]; as many channels as
# detectors, invertible. Empty: the channels are the detectors. On the diagonal alone: the detectors' complex calibration
# constants. [[1, 1], [-1, 1]] / sqrt(2): a lossless sum-difference hybrid of two beams.
float64[] matrix

# Where the channels are formed, if there is a matrix. True: in the antenna, so that noise_power is of the receivers behind
# it, one per channel. False: behind the receivers, so that noise_power is of the detectors' receivers and the channels'
# noise is correlated, matrix * diag(noise_power) * matrix^H.
bool matrix_in_antenna

# Receiver noise, one entry per receiver (see matrix_in_antenna): E|n|^2 of one complex phase-history sample, both
# quadratures together, in the unit of the samples squared. Zero: not known.
float64[] noise_power

# Full scale of the receivers: magnitude that the real and the imaginary part of a sample cannot exceed, in the unit of
# the samples; what reaches it is taken for clipped. Of a converter the last value that it shows on both sides. Zero: not
# known.
float64 full_scale

# Slant ranges [m] over which a channel does not receive, as a blanked receiver: first and last range of interval i, of
# channel blanked_channels[i], at blanked_ranges[2 i] and blanked_ranges[2 i + 1]. Empty: all channels receive everywhere.
uint32[] blanked_channels
float64[] blanked_ranges
""",
        "sal_height_msgs/msg/ComplexImage": r"""# Single-look complex image (SLC) of one channel. The phase of a point is -4 pi R / wavelength with R its distance
# from the middle of the aperture, relative to that of the pixel it falls in.

# stamp: that of the ChannelFrame it was made from. frame_id: "map" (ENU).
std_msgs/Header header

# Dwell and channel, as in the ChannelFrame.
uint32 dwell
uint32 channel

ImageGrid grid
Aperture aperture

# Receiver noise in the image: E|n|^2 of one pixel, both quadratures, in the unit of samples squared. Zero: not known.
float64 noise_power

# Share of the real and imaginary parts of raw samples that were at or beyond full_scale (SensorInfo) in the receivers the
# channel is made of, 0 to 1; NaN: not known.
float32 saturated_share

# Whether the delay of the air is taken out of the ranges. Empty: not known.
string AIR_REMOVED = "removed"
string AIR_LEFT = "left"
string air_delay

# Complex samples, real and imaginary part in turn, row-major [row][col]. Scaled so that a point of phase-history
# amplitude A has the peak value A. Pixels whose aperture was not sampled are NaN.
float32[] samples

# Place of the dwell in the order in which the node that made this has processed its dwells, from 0.
uint64 order

# What speaks against the product, and how well the data fit what was assumed. Empty: nothing was found; not tested.
Doubt[] doubts
FitTest[] fit

Provenance provenance
""",
        "sal_height_msgs/msg/Count": r"""# A number of messages, dwells or events under a name: a reason, a kind of event, or a topic.
string name
uint64 count
""",
        "sal_height_msgs/msg/Doubt": r"""# A reason to distrust a product: something that nobody stated, or that the data contradict.

# Which one: a few words that do not change from dwell to dwell, such as "odometry without covariance".
string name

# What is doubtful, in which dwell and by how much, and what to do about it.
string sentence

# The channel that it concerns; ALL_CHANNELS: the dwell as a whole.
int32 ALL_CHANNELS = -1
int32 channel

# Size of what was found, in the unit below; NaN: it has none.
float64 size
string unit

# Probability of so much or more if nothing is wrong; NaN: it was not tested.
float64 p_value
""",
        "sal_height_msgs/msg/DwellLoss": r"""# Messages of a dwell that a node left out, and why: on topic losses, one for each loss. Counts by reason, as NodeAccount has
# them, are sums of these.

# stamp: when it happened, by the node's clock. frame_id: empty.
std_msgs/Header header

# Name of the node with its namespace, without leading slash.
string node

# Whether a dwell is known; if not, the next three fields have no meaning.
bool of_dwell

# The dwell: SensorInfo.config_hash of its sensor, its number and the time of its first pulse.
string config_hash
uint32 dwell
builtin_interfaces/Time dwell_stamp

# Messages that were left out.
uint32 messages

# Why: the name under which it is counted, and a sentence that says what is wrong, where, and what to do.
string reason
string sentence
""",
        "sal_height_msgs/msg/FitTest": r"""# How well the data of a dwell, or of one of its channels, fit what was assumed of the sensor.

# What was tested, such as "noise level" or "gain".
string name

# The channel that was tested; ALL_CHANNELS: the dwell as a whole.
int32 ALL_CHANNELS = -1
int32 channel

# Value of the test, and the probability of so much or more if the assumptions hold.
float64 statistic
float64 p_value

# Departure that fits best, in the unit below, and its standard deviation; NaN: it was not estimated.
float64 size
float64 sigma
string unit
""",
        "sal_height_msgs/msg/HeightImage": r"""# Height of up to three scatterers in every pixel, with their uncertainty and the reason where one is missing.

# Values of validity.
uint8 OK = 0                      # the first surface can be used
uint8 LOW_CNR = 1                 # too little signal above the noise
uint8 OUTSIDE_ARRAY = 2           # the angle lies outside the span of the detectors' beams
uint8 OUTSIDE_PAIR = 3            # monopulse: the discriminant has no angle inside the pair
uint8 NOT_ONE_SCATTERER = 4       # the channels do not fit a single scatterer (layover)
uint8 MISSING_DATA = 5            # samples are missing, or samples or results are not finite
uint8 TWO_SCATTERERS = 6          # layover resolved: the first surface has the stronger scatterer, the second the other
uint8 AMBIGUOUS = 7               # another elevation is nearly as likely
uint8 SATURATED = 8               # usable but for a channel of the dwell, in which too many samples are clipped
uint8 INTERPOLATED = 9            # relief tracker: no usable measurement here; height and sigma follow from neighbours
uint8 THREE_SCATTERERS = 10       # layover of three, each in a surface of its own, the strongest first
uint8 EXTENDED = 11               # one surface that spreads over elevation, as a slope or a hedge; its middle is given
uint8 NO_SIGNAL = 12              # nothing stands out from noise and sidelobes, as in shadow
uint8 IMPRECISE = 13              # a scatterer is there, but its sigma is above the limit of the estimator
uint8 NO_GROUND = 14              # canopy_ground: ground and the canopy above it cannot be separated, or one is missing

# Radius [m] of the sphere that heights refer to, the mean earth radius (IUGG); the sphere touches the origin of the map
# frame from below. A constant of the contract: it is the same in every height image and relief map.
float64 EARTH_RADIUS = 6371008.8

# stamp: that of the ChannelFrames it was made from. frame_id: "map" (ENU).
std_msgs/Header header

uint32 dwell

# Estimator that made it: "monopulse", "ml", ..., or "tracked": one of these, smoothed by relief_tracker.
string estimator

# Pixels after looks were taken; all arrays below are row-major [row][col].
ImageGrid grid
Aperture aperture

# Looks (independent pixels averaged) in range and azimuth.
uint32 range_looks
uint32 azimuth_looks

# One of the constants above per pixel, rows * cols entries.
uint8[] validity

# Scatterers of each pixel, the strongest first. At least one surface; a second or third only from estimators that look
# for that many scatterers.
Surface[<=3] surfaces

# Probability that a pixel holds 0, 1, 2 or 3 scatterers, or one extended surface: 5 numbers per pixel in this order,
# [row][col][order], with the sum 1; NaN in pixels where it was not estimated. Empty: not estimated in this image.
float32[] order_probability

# Place of the dwell in the order in which the node that made this has processed its dwells, from 0.
uint64 order

# What speaks against the product, and how well the data fit what was assumed. Empty: nothing was found; not tested.
Doubt[] doubts
FitTest[] fit

Provenance provenance
""",
        "sal_height_msgs/msg/ImageGrid": r"""# Where the pixels of an image lie: a plane in the frame of the message's header (ENU "map": x east, y north, z up).
# Centre of pixel (row, col) = origin + row * row_spacing * row_direction + col * col_spacing * col_direction.

# Centre of pixel (0, 0) [m].
geometry_msgs/Point origin

# Unit vector of growing row: away from the sensor (range).
geometry_msgs/Vector3 row_direction

# Unit vector of growing col: along the flight (azimuth).
geometry_msgs/Vector3 col_direction

# Distance between neighbouring pixel centres [m].
float64 row_spacing
float64 col_spacing

# Shape of the image.
uint32 rows
uint32 cols
""",
        "sal_height_msgs/msg/Mounting": r"""# How the sensor is fixed to the platform.

# Name of the sensor frame: origin in the antenna's phase centre; x forward, y left, z up as base_link (REP-103). The beams
# lie in the plane x = 0, elevations count from -z.
string frame_id

# Position of the antenna's phase centre in base_link axes [m], from the origin of base_link; finite.
geometry_msgs/Vector3 lever_arm

# Covariance of the lever arm in base_link axes [m^2], 9 numbers, row-major. Empty: not known; zeros: exact.
float64[] lever_arm_covariance

# Rotation that turns the axes of the sensor frame into those of base_link (boresight alignment), unit quaternion.
geometry_msgs/Quaternion rotation

# Covariance of that rotation about the axes of base_link [rad^2], 9 numbers, row-major. Empty: not known; zeros: exact.
float64[] rotation_covariance
""",
        "sal_height_msgs/msg/NodeAccount": r"""# What became of a node's messages so far: on /progress, several times a second and after every piece of work, while
# somebody subscribes. At any time received = processed + dropped + waiting.

# stamp: when it was published, by the node's clock. frame_id: empty.
std_msgs/Header header

# Name of the node with its namespace, without leading slash.
string node

# Messages since the node has started: received, processed, and published on all topics.
uint64 received
uint64 processed
uint64 published

# Messages that were received and are neither processed nor dropped yet, and pieces of work that the worker has at hand or
# before it.
uint64 waiting
uint32 jobs

# Whether the node can process the first dwell.
bool ready

# Dwells of which a source has published the whole or a part.
uint64 dwells

# Dwells that are processed and whose products follow once later dwells have arrived.
uint64 unpublished

# Calibrations that the node has received, or published if it plays a bag.
uint64 calibrations

# Messages left out, by reason, and others, such as odometry, that could not be used, by kind; the same of the last minute.
Count[] dropped
Count[] ignored
Count[] dropped_last_minute
Count[] ignored_last_minute

# Events that cost no message, such as "odometry.bridged".
Count[] events

# By topic: messages published where all of them are kept, subscribers, messages that the publisher has sent and that have
# not arrived, and, of a recorder, messages in the bag.
Count[] published_on
Count[] subscribers
Count[] missed
Count[] recorded

# Messages that could not be written to the bag (recorder).
uint64 unwritten

# Dwells that arrive and that are processed in a second; time from a whole dwell to its product [ms]: half of them, and
# 95 %, take no longer. NaN: not known yet.
float64 offered_hz
float64 achieved_hz
float64 latency_p50_ms
float64 latency_p95_ms

# Of the node's process: processor time [s], memory [MB], number.
float64 cpu_s
float64 memory_mb
uint32 pid

# Why messages were last left out, a sentence; empty: none were.
string last_drop
""",
        "sal_height_msgs/msg/Provenance": r"""# How a product was made: enough to make it again, or to see why two products differ.

# Version of the sal_height package that made it, e.g. "0.1.0".
string code_version

# Identity of the sensor description (SensorInfo.config_hash) it was made with.
string config_hash

# Identity of the calibration that was applied (Calibration.id); empty: none.
string calibration_id

# Parameters of all processing stages so far. The name is that of the stage, a dot and that of its parameter, e.g.
# "ml_height.objective".
rcl_interfaces/Parameter[] parameters

# Phase error [rad] that autofocus estimated and removed, one per pulse of the aperture, the same in all channels;
# empty: none.
float32[] autofocus_phase
""",
        "sal_height_msgs/msg/ReliefLayer": r"""# One height per cell of a ReliefMap; all arrays have rows * cols entries, row-major [row][col], row 0 the southernmost.

# Values of name.
string MEAN = "mean"          # mean of all height images, each weighted by inverse variance
string GROUND = "ground"      # ground that is estimated from all surfaces of all height images, the highest of each cell
string SURFACE = "surface"    # highest surface of each cell, whatever it is of
string name

# Height [m] at the centre of the cell; in MEAN that of the ground, from the strongest scatterer of each pixel and the
# weaker ones that are all but certain to be there. NaN where nothing was seen.
float32[] height

# Standard deviation [m] of that height at that place: errors move a point to the side as well, so that it depends on the
# slope of the ground, which is estimated from neighbouring pixels; where it cannot be estimated, slopes up to 45 degrees
# are allowed for. It includes the spread of heights in cells that contain a step. What pose and beams leave open is taken
# as common to all pixels of all dwells, so that no average reduces it. NaN where nothing was seen.
float32[] sigma

# The part of sigma that all cells share [m]. Empty: not stated separately.
float32[] common_sigma

# How much the dwells disagree, over what their sigmas let expect: square root of chi-square per degree of freedom. Near 1
# if sigmas are right, smaller if dwells err alike; greater where something moved. NaN where fewer than two height images
# saw the cell.
float32[] disagreement

# What the height of each cell rests on. Empty: on measurements, wherever it is not NaN.
uint8 MEASURED = 0
uint8 INTERPOLATED = 1      # on neighbouring cells
uint8 SHADOW = 2            # no height: the cell was hidden behind what stands before it
uint8 UNSEEN = 3            # no height, for any other reason
uint8[] kind

# Height images that saw the cell.
uint32[] count
""",
        "sal_height_msgs/msg/ReliefMap": r"""# Heights of successive dwells in one grid on the ground, in one or more layers. Where the origin of the map frame on the
# earth is known, the grid is one of a coordinate reference system, and heights are above its ellipsoid, or above its geoid
# if it names one. Otherwise they are above the sphere of radius HeightImage.EARTH_RADIUS, which touches the origin of the
# map frame from below.

# stamp: that of the last height image entered. frame_id: the map frame, "map" (ENU), in which the sensor's poses are.
std_msgs/Header header

# Coordinate reference system of the grid, as PROJ names it, for example "EPSG:32632". Empty: local coordinates, see
# origin_east.
string crs

# Dwell of the last height image entered.
uint32 dwell

# Height images entered so far.
uint32 images

# Estimator that made them: "monopulse", "ml", ...
string estimator

# Centre of cell (0, 0), the south-west corner: easting and northing [m] in the system, or distances east and north along
# the sphere from the map frame's origin, azimuthal equidistant (the great circle leaves the origin in the direction
# (east, north)). That of cell (row, col) is origin_east + col * cell_size, origin_north + row * cell_size. The edges of
# cells are at multiples of cell_size.
float64 origin_east
float64 origin_north

# Side of a cell [m].
float64 cell_size

# Shape of all layers.
uint32 rows
uint32 cols

# The heights; the first layer is what a viewer of one layer shows.
ReliefLayer[] layers

# That of the last height image, with the parameters of the node that made the map.
Provenance provenance
""",
        "sal_height_msgs/msg/SensorInfo": r"""# What a receiver must know of the sensor to process its frames. Latched (transient local), like
# sensor_msgs/CameraInfo; published once at start and again whenever it changes.
#
# Conventions of all messages of this package: angles in rad, SI units; complex numbers are stored as real and imaginary
# part in turn; a text that names one of several kinds has the constants it may take beside it.

# Version of this contract, for contract_version. It grows when the meaning of a message changes.
uint32 CONTRACT_VERSION = 3

# Values of look_side: the sign of the cross-track direction.
int8 LEFT = -1
int8 RIGHT = 1

# Values of mode.
string SPOTLIGHT = "spotlight"    # held on the scene during a dwell, which is an aperture of its own
string STRIPMAP = "stripmap"      # fixed to the body; consecutive dwells are blocks of one unbroken sequence of pulses

# stamp: when the description became valid. frame_id: "base_link", body axes FLU (REP-103: x forward, y left, z up), in
# which mounting is given.
std_msgs/Header header

# CONTRACT_VERSION that the publisher was built with. Receivers refuse versions that they do not know, and 0.
uint32 contract_version

# Name of the sensor or preset, for people.
string name

# Identity of this description: any text that changes whenever a value changes, such as a hash. Every ChannelFrame and
# every product repeats it, so that frames never meet a description that is not their own.
string config_hash

# Identity of the calibration the sensor itself has applied; empty: none.
string calibration_id

# Side the sensor looks to: LEFT or RIGHT of the direction of flight.
int8 look_side

# How the antenna is steered: SPOTLIGHT or STRIPMAP.
string mode

# Number of pulses in a dwell.
uint32 pulse_count

# Pulse repetition frequency [Hz].
float64 pulse_repetition_frequency

# What the fast-time samples of a pulse are.
Waveform waveform

# Receive beams of the detectors, around boresights in the sensor frame.
BeamModel beams

# How well the beams are known: root mean square error of the amplitude of each beam, complex, over its greatest amplitude.
# 0: perfectly, but for what a calibration says.
float64 beam_uncertainty

# What the channels are made of, and their noise.
ChannelModel channels

# Where the antenna is on the platform, and how it is turned.
Mounting mounting

# How well the rest of this description is known.
SensorUncertainty uncertainty
""",
        "sal_height_msgs/msg/SensorUncertainty": r"""# How well the description of a sensor is known: one standard deviation each. Empty: not stated, which is not the same as 0:
# exact.

# Delay of the echoes that is not in the range reference, as of cables and filters [m of slant range].
float64[<=1] range_delay

# Rate of the sample clock over that described, relative.
float64[<=1] sample_clock

# Time by which stamps of platform/odometry are late against those of the frames [s].
float64[<=1] odometry_delay

# Distance between the beams over that described, relative: an error that grows with the angle from the middle of the array.
float64[<=1] beam_pitch

# Width of the beams over that described, relative.
float64[<=1] beam_width

# Gain of the channels against each other: of ln |gain|, and of its phase [rad].
float64[<=1] channel_gain
float64[<=1] channel_phase

# Receiver noise over that described, relative.
float64[<=1] noise_power
""",
        "sal_height_msgs/msg/Surface": r"""# One scatterer per pixel of a HeightImage; all arrays have rows * cols entries, row-major [row][col]. NaN where the pixel
# has no such scatterer, or its height is not valid.

# Height [m] above the sphere of radius HeightImage.EARTH_RADIUS.
float32[] height

# Standard deviation of height [m], that of the platform's pose included.
float32[] sigma

# Carrier-to-noise ratio [dB] of a hypothetical detector looking straight at the scatterer; NaN where not estimated. The
# first surface has it in every pixel with a signal, also where the height is not valid.
float32[] cnr_db

# Horizontal position [m] of the scatterer in map, relative to HeightImage.grid.origin: east and north.
float32[] east
float32[] north

# Standard deviation [m] of the surface's own heights within the pixel: 0 for a single scatterer, greater on slopes and in
# hedges; NaN where not estimated.
float32[] spread

# Covariance [m^2] of the position in map, without the error of the platform's pose: 6 numbers per pixel, [row][col][6], in
# the order east-east, east-north, east-up, north-north, north-up, up-up. Errors of different pixels are independent.
float32[] covariance

# The part of the covariance that follows from the platform's pose, in the same order; all pixels of a dwell share this
# error. Empty: the uncertainty of the pose is not known.
float32[] common_covariance
""",
        "sal_height_msgs/msg/Waveform": r"""# What the fast-time samples of a pulse are.

# Values of kind; see ChannelFrame for the formulas.
string SPECTRUM = "spectrum"      # samples in fast-time frequency
string CHIRP = "chirp"            # the echo of a linear FM pulse at complex baseband, sampled in time: needs a matched filter
string DERAMPED = "deramped"      # the echo mixed with a replica of the pulse (stretch), residual video phase still in it

# One of the constants above.
string kind

# Carrier wavelength [m]; its frequency is the centre of the band.
float64 wavelength

# Bandwidth of the pulse [Hz]; |chirp_rate| * pulse_duration for a linear FM. For "spectrum", sample k of N lies at
# c / wavelength + (k - (N - 1) / 2) * bandwidth / N.
float64 bandwidth

# Number N of fast-time samples in a pulse.
uint32 sample_count

# Rate of the linear FM [Hz/s], negative for a falling one. 0 for "spectrum".
float64 chirp_rate

# Duration of the pulse [s]. 0 for "spectrum".
float64 pulse_duration

# Rate of the complex fast-time samples [Hz]. 0 for "spectrum".
float64 sampling_rate
""",
        "sensor_msgs/msg/FluidPressure": r"""# Single pressure reading.  This message is appropriate for measuring the
# pressure inside of a fluid (air, water, etc).  This also includes
# atmospheric or barometric pressure.
#
# This message is not appropriate for force/pressure contact sensors.

std_msgs/Header header # timestamp of the measurement
                             # frame_id is the location of the pressure sensor

float64 fluid_pressure       # Absolute pressure reading in Pascals.

float64 variance             # 0 is interpreted as variance unknown
""",
        "sensor_msgs/msg/Image": r"""# This message contains an uncompressed image
# (0, 0) is at top-left corner of image

std_msgs/Header header # Header timestamp should be acquisition time of image
                             # Header frame_id should be optical frame of camera
                             # origin of frame should be optical center of cameara
                             # +x should point to the right in the image
                             # +y should point down in the image
                             # +z should point into to plane of the image
                             # If the frame_id here and the frame_id of the CameraInfo
                             # message associated with the image conflict
                             # the behavior is undefined

uint32 height                # image height, that is, number of rows
uint32 width                 # image width, that is, number of columns

# The legal values for encoding are in file include/sensor_msgs/image_encodings.hpp
# If you want to standardize a new string format, join
# ros-users@lists.ros.org and send an email proposing a new encoding.

string encoding       # Encoding of pixels -- channel meaning, ordering, size
                      # taken from the list of strings in include/sensor_msgs/image_encodings.hpp

uint8 is_bigendian    # is this data bigendian?
uint32 step           # Full row length in bytes
uint8[] data          # actual matrix data, size is (step * rows)
""",
        "sensor_msgs/msg/Imu": r"""# This is a message to hold data from an IMU (Inertial Measurement Unit)
#
# Accelerations should be in m/s^2 (not in g's), and rotational velocity should be in rad/sec
#
# If the covariance of the measurement is known, it should be filled in (if all you know is the
# variance of each measurement, e.g. from the datasheet, just put those along the diagonal)
# A covariance matrix of all zeros will be interpreted as "covariance unknown", and to use the
# data a covariance will have to be assumed or gotten from some other source
#
# If you have no estimate for one of the data elements (e.g. your IMU doesn't produce an
# orientation estimate), please set element 0 of the associated covariance matrix to -1
# If you are interpreting this message, please check for a value of -1 in the first element of each
# covariance matrix, and disregard the associated estimate.

std_msgs/Header header

geometry_msgs/Quaternion orientation
float64[9] orientation_covariance # Row major about x, y, z axes

geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance # Row major about x, y, z axes

geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance # Row major x, y z
""",
        "sensor_msgs/msg/NavSatFix": r"""# Navigation Satellite fix for any Global Navigation Satellite System
#
# Specified using the WGS 84 reference ellipsoid

# header.stamp specifies the ROS time for this measurement (the
#        corresponding satellite time may be reported using the
#        sensor_msgs/TimeReference message).
#
# header.frame_id is the frame of reference reported by the satellite
#        receiver, usually the location of the antenna.  This is a
#        Euclidean frame relative to the vehicle, not a reference
#        ellipsoid.
std_msgs/Header header

# Satellite fix status information.
NavSatStatus status

# Latitude [degrees]. Positive is north of equator; negative is south.
float64 latitude

# Longitude [degrees]. Positive is east of prime meridian; negative is west.
float64 longitude

# Altitude [m]. Positive is above the WGS 84 ellipsoid
# (quiet NaN if no altitude is available).
float64 altitude

# Position covariance [m^2] defined relative to a tangential plane
# through the reported position. The components are East, North, and
# Up (ENU), in row-major order.
#
# Beware: this coordinate system exhibits singularities at the poles.
float64[9] position_covariance

# If the covariance of the fix is known, fill it in completely. If the
# GPS receiver provides the variance of each measurement, put them
# along the diagonal. If only Dilution of Precision is available,
# estimate an approximate covariance from that.

uint8 COVARIANCE_TYPE_UNKNOWN = 0
uint8 COVARIANCE_TYPE_APPROXIMATED = 1
uint8 COVARIANCE_TYPE_DIAGONAL_KNOWN = 2
uint8 COVARIANCE_TYPE_KNOWN = 3

uint8 position_covariance_type
""",
        "sensor_msgs/msg/NavSatStatus": r"""# Navigation Satellite fix status for any Global Navigation Satellite System.
#
# Whether to output an augmented fix is determined by both the fix
# type and the last time differential corrections were received.  A
# fix is valid when status >= STATUS_FIX.

int8 STATUS_UNKNOWN = -2        # status is not yet set
int8 STATUS_NO_FIX =  -1        # unable to fix position
int8 STATUS_FIX =      0        # unaugmented fix
int8 STATUS_SBAS_FIX = 1        # with satellite-based augmentation
int8 STATUS_GBAS_FIX = 2        # with ground-based augmentation

int8 status -2 # STATUS_UNKNOWN

# Bits defining which Global Navigation Satellite System signals were
# used by the receiver.

uint16 SERVICE_UNKNOWN = 0  # Remember service is a bitfield, so checking (service & SERVICE_UNKNOWN) will not work. Use == instead.
uint16 SERVICE_GPS =     1
uint16 SERVICE_GLONASS = 2
uint16 SERVICE_COMPASS = 4      # includes BeiDou.
uint16 SERVICE_GALILEO = 8

uint16 service
""",
        "sensor_msgs/msg/PointCloud2": r"""# This message holds a collection of N-dimensional points, which may
# contain additional information such as normals, intensity, etc. The
# point data is stored as a binary blob, its layout described by the
# contents of the "fields" array.
#
# The point cloud data may be organized 2d (image-like) or 1d (unordered).
# Point clouds organized as 2d images may be produced by camera depth sensors
# such as stereo or time-of-flight.

# Time of sensor data acquisition, and the coordinate frame ID (for 3d points).
std_msgs/Header header

# 2D structure of the point cloud. If the cloud is unordered, height is
# 1 and width is the length of the point cloud.
uint32 height
uint32 width

# Describes the channels and their layout in the binary data blob.
PointField[] fields

bool    is_bigendian # Is this data bigendian?
uint32  point_step   # Length of a point in bytes
uint32  row_step     # Length of a row in bytes
uint8[] data         # Actual point data, size is (row_step*height)

bool is_dense        # True if there are no invalid points
""",
        "sensor_msgs/msg/PointField": r"""# This message holds the description of one point entry in the
# PointCloud2 message format.
uint8 INT8    = 1
uint8 UINT8   = 2
uint8 INT16   = 3
uint8 UINT16  = 4
uint8 INT32   = 5
uint8 UINT32  = 6
uint8 FLOAT32 = 7
uint8 FLOAT64 = 8

# Common PointField names are x, y, z, intensity, rgb, rgba
string name      # Name of field
uint32 offset    # Offset from start of point struct
uint8  datatype  # Datatype enumeration, see above
uint32 count     # How many elements in the field
""",
        "sensor_msgs/msg/RelativeHumidity": r"""# Single reading from a relative humidity sensor.
# Defines the ratio of partial pressure of water vapor to the saturated vapor
# pressure at a temperature.

std_msgs/Header header # timestamp of the measurement
                             # frame_id is the location of the humidity sensor

float64 relative_humidity    # Expression of the relative humidity
                             # from 0.0 to 1.0.
                             # 0.0 is no partial pressure of water vapor
                             # 1.0 represents partial pressure of saturation

float64 variance             # 0 is interpreted as variance unknown
""",
        "sensor_msgs/msg/Temperature": r"""# Single temperature reading.

std_msgs/Header header # timestamp is the time the temperature was measured
                             # frame_id is the location of the temperature reading

float64 temperature          # Measurement of the Temperature in Degrees Celsius.

float64 variance             # 0 is interpreted as variance unknown.
""",
        "std_msgs/msg/Header": r"""# Standard metadata for higher-level stamped data types.
# This is generally used to communicate timestamped data
# in a particular coordinate frame.

# Two-integer timestamp that is expressed as seconds and nanoseconds.
builtin_interfaces/Time stamp

# Transform frame with which this data is associated.
string frame_id
""",
        "tf2_msgs/msg/TFMessage": r"""geometry_msgs/TransformStamped[] transforms
""",
    }
)

HASHES: Mapping[str, str] = MappingProxyType(
    {
        "builtin_interfaces/msg/Time": "RIHS01_b106235e25a4c5ed35098aa0a61a3ee9c9b18d197f398b0e4206cea9acf9c197",
        "diagnostic_msgs/msg/DiagnosticArray": "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
        "diagnostic_msgs/msg/DiagnosticStatus": "RIHS01_b0e3e692ea2d54a8af2f4ef1930e81556a2db55216b771f8a7d2724ed47bf0e4",
        "diagnostic_msgs/msg/KeyValue": "RIHS01_d68081eaa540288c5440753baecef0c4e16e81a5f78ad68902ded5100413bb42",
        "geometry_msgs/msg/Point": "RIHS01_6963084842a9b04494d6b2941d11444708d892da2f4b09843b9c43f42a7f6881",
        "geometry_msgs/msg/Pose": "RIHS01_d501954e9476cea2996984e812054b68026ae0bfae789d9a10b23daf35cc90fa",
        "geometry_msgs/msg/PoseStamped": "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
        "geometry_msgs/msg/PoseWithCovariance": "RIHS01_9a7c0fd234b7f45c6098745ecccd773ca1085670e64107135397aee31c02e1bb",
        "geometry_msgs/msg/PoseWithCovarianceStamped": "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e",
        "geometry_msgs/msg/Quaternion": "RIHS01_8a765f66778c8ff7c8ab94afcc590a2ed5325a1d9a076ffff38fbce36f458684",
        "geometry_msgs/msg/Transform": "RIHS01_beb83fbe698636351461f6f35d1abb20010c43d55374d81bd041f1ba2581fddc",
        "geometry_msgs/msg/TransformStamped": "RIHS01_0a241f87d04668d94099cbb5ba11691d5ad32c2f29682e4eb5653424bd275206",
        "geometry_msgs/msg/Twist": "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
        "geometry_msgs/msg/TwistStamped": "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
        "geometry_msgs/msg/TwistWithCovariance": "RIHS01_49f574f033f095d8b6cd1beaca5ca7925e296e84af1716d16c89d38b059c8c18",
        "geometry_msgs/msg/Vector3": "RIHS01_cc12fe83e4c02719f1ce8070bfd14aecd40f75a96696a67a2a1f37f7dbb0765d",
        "nav_msgs/msg/Odometry": "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
        "rcl_interfaces/msg/Parameter": "RIHS01_ddfe6442cffc462317adb5c92536a7b6dd55858c5c3e1e328165a6b73c2831af",
        "rcl_interfaces/msg/ParameterEvent": "RIHS01_043e627780fcad87a22d225bc2a037361dba713fca6a6b9f4b869a5aa0393204",
        "rcl_interfaces/msg/ParameterType": "RIHS01_df29ed057a834862187be24dd187d981790ff3ea6502f4cd27b432cbc42c6d46",
        "rcl_interfaces/msg/ParameterValue": "RIHS01_115fc089a387e23c7ecd3525c9189c379109119d6ab82e8dfbde0fdf6a7f9b68",
        "rosgraph_msgs/msg/Clock": "RIHS01_692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564",
        "sal_height_msgs/msg/Aperture": "RIHS01_3aab93d3234cc9ef3db831d0d4ceb4e19cdd935237473612cf4f71643664e916",
        "sal_height_msgs/msg/BeamModel": "RIHS01_3ee7b930e395cd37416b786b95b47c0051a054fbc90579baff6f370109b8302a",
        "sal_height_msgs/msg/BeamTable": "RIHS01_e81e537529dd19e01c30b5a92924f67b1baed2fd73da88b4cbb6b55e03275e7d",
        "sal_height_msgs/msg/Calibration": "RIHS01_de7a1fa6880d4545f4a9c7f47b0ef6379675399324f345f9e7cf4eb296f6a36a",
        "sal_height_msgs/msg/ChannelFrame": "RIHS01_b23c367d136a182262943584351e596bad508ea10021093b1f0840a880b27abd",
        "sal_height_msgs/msg/ChannelModel": "RIHS01_bbece7d8ac0b64931000c8c8302c698718e2c73058a210b32f6bf5bda8e2671e",
        "sal_height_msgs/msg/ComplexImage": "RIHS01_b7b132e77581f75c6c7c4ad7df205d0e791d398791c3c06859dbf3565199dcb1",
        "sal_height_msgs/msg/Count": "RIHS01_f6501b54aac66cf682e1924114733c38f628d056432c2be42f6cb3a2c7cb32e3",
        "sal_height_msgs/msg/Doubt": "RIHS01_b0f9597c2546123442957bc72aa25051213bde23fc9d4286305bcef91ad66383",
        "sal_height_msgs/msg/DwellLoss": "RIHS01_380091f2b7320db39190c3933e8509f780f1a75daa6c09a7c3422517b66b3604",
        "sal_height_msgs/msg/FitTest": "RIHS01_3cb0314cb5d7cd36f1831a25892cc9cc2a05f25608b2bacc0e920ca38fd9e4c8",
        "sal_height_msgs/msg/HeightImage": "RIHS01_983288b8d52900e1d0f498d940b5c3783d6eded76062a586d2776a3fb884f019",
        "sal_height_msgs/msg/ImageGrid": "RIHS01_2dbc5de4b8661d51cc563cf03161d1a75976895a7cd61e093aa6880e4eea045d",
        "sal_height_msgs/msg/Mounting": "RIHS01_71931016077e61b6c0fcdebfe2472aa44460cafedd7beb5da82f1389c9b79e66",
        "sal_height_msgs/msg/NodeAccount": "RIHS01_e633360aaea71bf2c1b324a32a9ac2bfa3da46dd76ac0cd23a846f081be8b6d7",
        "sal_height_msgs/msg/Provenance": "RIHS01_e9c4f3e698aa7af3bde1c53268b06f0e94f50adaff46e1a8a36ea08fb2f90515",
        "sal_height_msgs/msg/ReliefLayer": "RIHS01_e16e65ed11139f6438a416b309b50819c317f8eef6936cf8b89b691607bb9df2",
        "sal_height_msgs/msg/ReliefMap": "RIHS01_912da77777a617b6c7bcd1f50d19c726daf0a7c4e12c72a7b1142c84059969e8",
        "sal_height_msgs/msg/SensorInfo": "RIHS01_47c4380b551ad35e51ad2ac419a233f7ba4f06e44678b7b41cdb45db402c0b30",
        "sal_height_msgs/msg/SensorUncertainty": "RIHS01_ad98912495ffefe8e7cd948d02a65cf7bca6a514786e97f0d95d53a91247a5a1",
        "sal_height_msgs/msg/Surface": "RIHS01_5b2651f54665818c0bb52d39ed3ed4fd3d5051a5f41ebb75450832247b65e39c",
        "sal_height_msgs/msg/Waveform": "RIHS01_7586df1676c029c006b7f86c591ceb0d1dc4101de1104dad2a013a351297f2bd",
        "sensor_msgs/msg/FluidPressure": "RIHS01_22dfb2b145a0bd5a31a1ac3882a1b32148b51d9b2f3bab250290d66f3595bc32",
        "sensor_msgs/msg/Image": "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
        "sensor_msgs/msg/Imu": "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
        "sensor_msgs/msg/NavSatFix": "RIHS01_62223ab3fe210a15976021da7afddc9e200dc9ec75231c1b6a557fc598a65404",
        "sensor_msgs/msg/NavSatStatus": "RIHS01_d1ed3befa628e09571bd273b888ba1c1fd187c9a5e0006b385d7e5e9095a3204",
        "sensor_msgs/msg/PointCloud2": "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
        "sensor_msgs/msg/PointField": "RIHS01_5c6a4750728c2bcfbbf7037225b20b02d4429634732146b742dee1726637ef01",
        "sensor_msgs/msg/RelativeHumidity": "RIHS01_8687c99b4fb393cb2e545e407b5ea7fd0b5d8960bcd849a0f86c544740138839",
        "sensor_msgs/msg/Temperature": "RIHS01_72514a14126ab9f8a9abec974c78e5610a367b59db5da355ff1fb982d5bad4b8",
        "std_msgs/msg/Header": "RIHS01_f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01",
        "tf2_msgs/msg/TFMessage": "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    }
)
