"""The formula compiler: functions traced to a tape, their derivatives, and compiled kernels."""
