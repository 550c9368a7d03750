"""The parts of the service that talk to the world, each alone: none imports another."""
