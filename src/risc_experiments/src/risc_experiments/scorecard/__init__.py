"""The scorecard (`./maap scorecard`): faults of every kind and severity against estimators and controllers, offline."""
