// The scalar type of the corrections in this variant: that of the matrix and of all vectors inside a round.
alias Inner = f64;
alias Inner3 = vec3<f64>;
alias Inner4 = vec4<f64>;
