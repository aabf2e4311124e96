"""Speed, memory and accuracy of the package against their targets: `make bench`."""
