"""Base package: what the driver, flight and vision packages share."""
