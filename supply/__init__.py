"""What is shipped beside our own code: its bill of materials, licences and known weaknesses. `make sbom licences audit`."""
