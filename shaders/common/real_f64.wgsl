// Scalar type of this variant.
alias Real = f64;
alias Real3 = vec3<f64>;
alias Real4 = vec4<f64>;
alias Real3x3 = mat3x3<f64>;

// Distance from 1 to the next larger scalar.
const EPSILON = Real(2.220446049250313e-16lf);

// Least square that is told from zero.
const SMALLEST = Real(1e-300lf);
