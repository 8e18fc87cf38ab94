#import real

// Sums that do not depend on their order: 96-bit integers, high word first, two's complement, in units of 2^-65 of a power of two
// above every summand. Of 2^30 summands, the most cells that a domain has, the sum still fits.
fn add96(a: vec3<u32>, b: vec3<u32>) -> vec3<u32> {
    let low = a.z + b.z;
    let carry_low = u32(low < b.z);
    let middle = a.y + b.y;
    let with_carry = middle + carry_low;
    let carry = u32(middle < b.y) + u32(with_carry < carry_low);
    return vec3<u32>(a.x + b.x + carry, with_carry, low);
}

fn negative96(a: vec3<u32>) -> vec3<u32> {
    return add96(~a, vec3<u32>(0u, 0u, 1u));
}

// bits: those of an f32 not below the largest magnitude of a summand, rounded to nearest.

// Whether they span a usable range: neither all zero (or below the least normal f32) nor infinite.
fn has_range(bits: u32) -> bool {
    let exponent = bits >> 23u;
    return exponent >= 1u && exponent <= 250u;
}

// 2^k for the exponent field of an f32 that is k + 127.
fn power_of_two(field: u32) -> Real {
    return Real(bitcast<f32>(field << 23u));
}

fn to96(value: Real, bits: u32) -> vec3<u32> {
    let word = Real(4294967296.0);
    // Below 2; each remainder is exact.
    let scaled = abs(value) * power_of_two(253u - (bits >> 23u)) * Real(2.0);
    let high = floor(scaled);
    let rest = (scaled - high) * word;
    let middle = floor(rest);
    let low = floor((rest - middle) * word);
    let sum = vec3<u32>(u32(high), u32(middle), u32(low));
    if value < Real(0.0) {
        return negative96(sum);
    }
    return sum;
}

fn from96(sum: vec3<u32>, bits: u32) -> Real {
    let word = Real(1.0 / 4294967296.0);
    let below_zero = (sum.x & 0x80000000u) != 0u;
    var a = sum;
    if below_zero {
        a = negative96(sum);
    }
    let magnitude = (Real(a.x) + (Real(a.y) + Real(a.z) * word) * word) * power_of_two((bits >> 23u) + 1u) * Real(0.5);
    return select(magnitude, -magnitude, below_zero);
}
