"""An AR.Drone 2.0 on real sockets: the ports, bytes and habits of the real one around a simulated world."""
