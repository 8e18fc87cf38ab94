// Scalar type of this variant.
alias Real = f32;
alias Real3 = vec3<f32>;
alias Real4 = vec4<f32>;
alias Real3x3 = mat3x3<f32>;

// Distance from 1 to the next larger scalar.
const EPSILON = Real(1.1920929e-7);

// Least square that is told from zero.
const SMALLEST = Real(1e-37);
