// A displacement as the sum of two f32, in the variant with f64, which forms the sum in f64. zero: unused here.

struct Pair {
    hi: vec3<f32>,
    lo: vec3<f32>,
}

fn pair_value(a: Pair) -> vec3<f64> {
    return vec3<f64>(a.hi) + vec3<f64>(a.lo);
}

fn pair_difference(a: Pair, b: Pair, zero: u32) -> vec3<f64> {
    return pair_value(a) - pair_value(b);
}

fn pair_plus(a: Pair, b: vec3<f64>, zero: u32) -> Pair {
    let sum = pair_value(a) + b;
    let hi = vec3<f32>(sum);
    return Pair(hi, vec3<f32>(sum - vec3<f64>(hi)));
}
