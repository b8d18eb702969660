"""What all packages of the project build on: errors, settings and their checks, files written whole, locks."""
