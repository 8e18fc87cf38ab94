// Sums over the components of the liquid that do not depend on their order: 64-bit integers, two's complement, in units
// of 2^-23 of the volume of a cell; the low and the high word at the label of the component.
const UNIT = 1.1920928955078125e-7;
const PER_VOLUME = 8388608.0;
const WORD = 4294967296.0;
const PER_WORD = 2.3283064365386963e-10;

// In the high word of a volume, which is less than 2^23: the component has a free surface or an open side.
const SURFACE = 0x80000000u;
// In that of a volume that leaves a component (see removed), until settle_removed has subtracted it from the target.
const REMOVED = 0x80000000u;

fn add64(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    let low = a.x + b.x;
    return vec2<u32>(low, a.y + b.y + u32(low < b.x));
}

fn negative64(a: vec2<u32>) -> vec2<u32> {
    return add64(~a, vec2<u32>(1u, 0u));
}

// value: volumes of cells, below 2^30.
fn fixed(value: f32) -> vec2<u32> {
    let scaled = round(abs(value) * PER_VOLUME);
    let high = floor(scaled * PER_WORD);
    let sum = vec2<u32>(u32(scaled - high * WORD), u32(high));
    return select(sum, negative64(sum), value < 0.0);
}

fn value_of(sum: vec2<u32>) -> f32 {
    let below_zero = (sum.y & 0x80000000u) != 0u;
    let magnitude = select(sum, negative64(sum), below_zero);
    let value = (f32(magnitude.y) * WORD + f32(magnitude.x)) * UNIT;
    return select(value, -value, below_zero);
}

// The sum without the mark.
fn volume_of(sum: vec2<u32>) -> f32 {
    return value_of(vec2<u32>(sum.x, sum.y & ~SURFACE));
}
