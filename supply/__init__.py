"""Bill of materials, licences and known weaknesses of what is shipped beside our own code. `make sbom licences audit`."""
