"""Health for Prometheus: `exposition` without I/O, `endpoint` over HTTP."""
