// Largest speed and least determinant as integers whose maximum does not depend on any order, and the number of inverted
// elements: words of extremes.
const FASTEST = 0u;
const WORST = 1u;
const N_INVERTED = 2u;

const SIGN = 0x80000000u;
// Bits of infinity.
const INFINITE = 0x7f800000u;
// What not-a-number is ranked as, above all.
const NOT_A_NUMBER = 0xffffffffu;

// The larger, the smaller x; the largest for not-a-number. Never 0.
fn smallness(x: f32) -> u32 {
    let bits = bitcast<u32>(x);
    if (bits & ~SIGN) > INFINITE {
        return NOT_A_NUMBER;
    }
    return select(~bits ^ SIGN, bits, (bits & SIGN) != 0u);
}

// Bits of the number of that smallness.
fn of_smallness(rank: u32) -> u32 {
    if rank == NOT_A_NUMBER {
        return ~SIGN;
    }
    return select(~rank ^ SIGN, rank, (rank & SIGN) != 0u);
}
