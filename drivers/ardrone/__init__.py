"""The AR.Drone 2.0: commands, navdata, video, and the link that holds them together."""
