"""The AR.Drone's sockets around the simulated drone: commands, navdata, video and configuration."""
