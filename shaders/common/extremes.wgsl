// Words of extremes: largest speed, least determinant and closing rate as integers, whose maximum is independent of the order, and
// the number of inverted elements.
const FASTEST = 0u;
const WORST = 1u;
const N_INVERTED = 2u;
const CLOSING = 3u;

const SIGN = 0x80000000u;
// Bits of infinity.
const INFINITE = 0x7f800000u;
// Rank of NaN, above all.
const NOT_A_NUMBER = 0xffffffffu;

// A rank that increases with decreasing x, largest for NaN, never 0.
fn smallness(x: f32) -> u32 {
    let bits = bitcast<u32>(x);
    if (bits & ~SIGN) > INFINITE {
        return NOT_A_NUMBER;
    }
    return select(~bits ^ SIGN, bits, (bits & SIGN) != 0u);
}

// Bits of the number with a rank.
fn of_smallness(rank: u32) -> u32 {
    if rank == NOT_A_NUMBER {
        return ~SIGN;
    }
    return select(~rank ^ SIGN, rank, (rank & SIGN) != 0u);
}
