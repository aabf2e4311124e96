"""Names of the topics of a sensor and its platform, without the namespace of the sensor."""

SENSOR_INFO = "sensor_info"
"""Description of the sensor, latched."""

PHASE_HISTORY = "phase_history"
"""Samples of one channel and dwell in each message."""

ODOMETRY = "platform/odometry"
"""State of the platform, nav_msgs/Odometry."""

SLC = "slc"
"""Complex image of one channel and dwell in each message."""

CALIBRATION = "calibration"
"""Calibration of receivers and beams, latched."""

MAP_ORIGIN = "map_origin"
"""Position of the origin of the map frame on the earth, sensor_msgs/NavSatFix, latched."""

LOSSES = "losses"
"""Dwells that nodes left out, and why."""

TF = "/tf"
"""Transforms of frames that move; of no namespace."""

TF_STATIC = "/tf_static"
"""Transforms that do not change; of no namespace."""
