// The scalar type of this variant.
alias Real = f64;
alias Real4 = vec4<f64>;
