"""What all nodes of risc_visual share: conversions and health."""
