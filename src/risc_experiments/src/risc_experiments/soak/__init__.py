"""`./maap soak`: one graph flies for hours, with faults, and is watched for what drifts."""
