"""The closed loop as a linear sampled system along a path: margins, step responses, a linear-quadratic start for gains."""
