"""A micro-controller's topics in the graph. `protocol` and `link` are pure; `ports` are the lines; `ros` ties them."""
