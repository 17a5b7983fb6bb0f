"""`./maap machines`: are the computers of a launch file ready, make them ready, bring the workspace to them."""
