"""Input mappings: from thrust and attitude to what a type of vehicle takes (thesis 5.1.3, 5.2)."""
