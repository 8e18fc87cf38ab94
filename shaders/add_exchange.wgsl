// liquid_components with an exchange, before component_targets: counts the volumes that left as shared and the first fillings
// as missing, so that the rest to share is that of the whole liquid after the exchange. One thread.
// exchange_totals: see exchange_totals. component_totals: see sum_components; the shares in place.
#import component_sums
#import exchange_totals

@group(0) @binding(0) var<storage, read_write> exchange_totals: array<atomic<u32>>;
@group(0) @binding(1) var<storage, read_write> component_totals: array<u32>;

fn total(word: u32) -> vec2<u32> {
    return vec2<u32>(atomicLoad(&exchange_totals[word]), atomicLoad(&exchange_totals[word + 1u]));
}

@compute @workgroup_size(1)
fn add_exchange() {
    let gone = add64(total(LEFT_VOLUME), total(SUNK_VOLUME));
    let shared_volume = vec2<u32>(component_totals[2], component_totals[3]);
    let sum = add64(add64(shared_volume, gone), negative64(total(FILLED_VOLUME)));
    component_totals[2] = sum.x;
    component_totals[3] = sum.y;
}
