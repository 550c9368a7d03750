"""Work on files and findings: report, replay, diagnosis, calibration, print, ROS 2 bags, installation."""
