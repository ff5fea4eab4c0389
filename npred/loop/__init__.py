"""The closed loop: actuator, engine, feedback and delay laws, the controller, and what is measured of loops."""
