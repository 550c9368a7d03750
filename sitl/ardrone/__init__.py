"""The AR.Drone without its sockets: its configuration, state, navdata and commands, on a simulated vehicle."""
