"""The closed loop: actuator, engine, feedback and delay laws, the controller, and the measures of loops."""
