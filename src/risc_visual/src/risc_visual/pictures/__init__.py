"""Pictures for papers and lab reports: rviz without a screen."""
