"""Connect the sonar, the vehicle and the logs of a maker called ACME to auv-mcm."""
