"""Connect the sonar, the inertial unit, the vehicle and the logs of a maker called ACME to auv-mcm."""
