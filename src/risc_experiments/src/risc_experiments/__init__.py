"""Whole flights: the virtual operator, the runner behind `./maap fly`, and offline closed-loop studies."""
