"""What drivers, flying and looking packages share: the ground floor."""
