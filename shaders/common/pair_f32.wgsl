// A displacement as the sum of two f32, in the variant without f64: sums and differences are keep 46 digits.
//
// The rounding errors of the sums below are zero in exact arithmetic, and compilers may simplify them to zero. kept()
// prevents that: zero is 0 in every step, which only the host knows.

struct Pair {
    hi: vec3<f32>,
    lo: vec3<f32>,
}

fn kept(x: vec3<f32>, zero: u32) -> vec3<f32> {
    return bitcast<vec3<f32>>(bitcast<vec3<u32>>(x) ^ vec3<u32>(zero));
}

fn pair_value(a: Pair) -> vec3<f32> {
    return a.hi + a.lo;
}

fn pair_difference(a: Pair, b: Pair, zero: u32) -> vec3<f32> {
    return kept(a.hi - b.hi, zero) + (a.lo - b.lo);
}

// Relative size of the first digit of the larger part that a sum drops, 22 below its first, so that hi + lo is an
// f64.
const DROPPED = 2.3841858e-7;

fn pair_plus(a: Pair, b: vec3<f32>, zero: u32) -> Pair {
    let d = kept(b, zero);
    let sum = kept(a.hi + d, zero);
    let part = kept(sum - a.hi, zero);
    let error = kept(a.hi - kept(sum - part, zero), zero) + kept(d - part, zero);
    let low = kept(a.lo + error, zero);
    let hi = kept(sum + low, zero);
    let lo = kept(sum - hi, zero) + low;
    let coarse = kept(abs(hi) * DROPPED, zero);
    return Pair(hi, kept(lo + coarse, zero) - coarse);
}
