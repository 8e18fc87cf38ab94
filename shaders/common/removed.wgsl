// Volumes that leave the components of a level in the sub-step, at their labels before it: sums of two words (see
// component_sums), with the mark REMOVED.
// The importing kernel declares component_removed: array<atomic<u32>>, and exchange_totals: array<atomic<u32>>.
#import component_sums
#import exchange_totals

// volume: of cells, at least 0. label: 0 for none.
fn remove_volume(label: u32, total: u32, volume: f32) {
    let sum = fixed(volume);
    if all(sum == vec2<u32>()) {
        return;
    }
    add_total(total, sum);
    if label > 0u {
        let carry = u32(atomicAdd(&component_removed[2u * label], sum.x) > ~sum.x);
        atomicAdd(&component_removed[2u * label + 1u], sum.y + carry);
        atomicOr(&component_removed[2u * label + 1u], REMOVED);
    }
}
