// Volumes that a level exchanges in the sub-step: sums of two words (see component_sums). Left through open sides, sunk, first
// fillings of sources, added by the limits of the targets.
// The importing kernel declares exchange_totals: array<atomic<u32>>.
const LEFT_VOLUME = 0u;
const SUNK_VOLUME = 2u;
const FILLED_VOLUME = 4u;
const LIMITED_VOLUME = 6u;

fn add_total(total: u32, sum: vec2<u32>) {
    let carry = u32(atomicAdd(&exchange_totals[total], sum.x) > ~sum.x);
    atomicAdd(&exchange_totals[total + 1u], sum.y + carry);
}
