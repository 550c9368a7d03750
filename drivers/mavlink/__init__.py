"""MAVLink links and an autopilot as vehicle: bytes and devices in, samples out; commands in, bytes out."""
