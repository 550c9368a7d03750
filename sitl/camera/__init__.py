"""The simulated camera: scene, light, lens, sensor, automatics, gimbal and video link."""
