"""Health for Prometheus: `exposition` formats it without I/O, `endpoint` serves it over HTTP."""
