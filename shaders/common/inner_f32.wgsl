// The scalar type of the corrections in this variant: that of the matrix and of all vectors inside a round.
alias Inner = f32;
alias Inner3 = vec3<f32>;
alias Inner4 = vec4<f32>;
