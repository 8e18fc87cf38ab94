// Scalar type of the corrections in this variant: the matrix and all vectors inside a refinement step.
alias Inner = f32;
alias Inner3 = vec3<f32>;
alias Inner4 = vec4<f32>;
