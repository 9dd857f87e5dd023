"""A lot of carpark_mj as a ROS 2 node."""
