// Scalar type of the corrections in this variant: the matrix and all vectors inside a refinement step.
alias Inner = f64;
alias Inner3 = vec3<f64>;
alias Inner4 = vec4<f64>;
