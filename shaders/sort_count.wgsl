// sort, first of three in a pass: counts each digit in each tile.
// One workgroup per tile; sums of integers do not depend on the order of atomics.
// radix: digit and list. args: length. keys: in. chunks: counts, digit by digit, tile by tile within a digit.
#import sort

@group(0) @binding(0) var<uniform> radix: SortPass;
@group(0) @binding(1) var<storage, read> args: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<u32>;
@group(0) @binding(3) var<storage, read_write> chunks: array<u32>;

var<workgroup> sh_counts: array<atomic<u32>, DIGITS>;

@compute @workgroup_size(WG_SIZE)
fn sort_count(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let length = args[radix.args + 3u];
    let tile = group_index(workgroup);
    if lane < DIGITS {
        atomicStore(&sh_counts[lane], 0u);
    }
    workgroupBarrier();
    let end = min((tile + 1u) * TILE, length);
    for (var ix = tile * TILE + lane; ix < end; ix += WG_SIZE) {
        atomicAdd(&sh_counts[digit_of(keys[ix], radix.shift)], 1u);
    }
    workgroupBarrier();
    let tiles = n_tiles(length);
    if lane < DIGITS && tile < tiles {
        chunks[lane * tiles + tile] = atomicLoad(&sh_counts[lane]);
    }
}
