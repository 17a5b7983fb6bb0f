"""`./maap machines`: check the computers of a launch file, set them up, and copy the workspace to them."""
