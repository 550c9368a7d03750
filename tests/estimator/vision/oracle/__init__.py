"""Vision in numpy, as it flew before the native core: the oracle that the core's is held to."""
