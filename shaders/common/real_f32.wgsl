// The scalar type of this variant.
alias Real = f32;
alias Real4 = vec4<f32>;
