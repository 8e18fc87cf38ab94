// sort, last of three in a pass: scatters every entry to its position, stable within a digit.
// One workgroup per tile; a thread has RUN consecutive entries, so that threads and entries are in the order of the
// list.
// radix: digit and list. args: length. chunks: positions of each tile's first entries, see sort_count. keys, values:
// in. keys_out, values_out: out.
#import sort

@group(0) @binding(0) var<uniform> radix: SortPass;
@group(0) @binding(1) var<storage, read> args: array<u32>;
@group(0) @binding(2) var<storage, read> chunks: array<u32>;
@group(0) @binding(3) var<storage, read> keys: array<u32>;
@group(0) @binding(4) var<storage, read> values: array<u32>;
@group(0) @binding(5) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(6) var<storage, read_write> values_out: array<u32>;

// Threads that sum the counts of one digit, and counts per thread.
const SHARES = WG_SIZE / DIGITS;
const SHARE = WG_SIZE / SHARES;

// Per digit and thread: the count of its entries, then the position of its next one.
var<workgroup> sh_places: array<u32, DIGITS * WG_SIZE>;
var<workgroup> sh_sums: array<u32, WG_SIZE>;

@compute @workgroup_size(WG_SIZE)
fn sort_scatter(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let length = args[radix.args + 3u];
    let tile = group_index(workgroup);
    for (var digit = 0u; digit < DIGITS; digit++) {
        sh_places[digit * WG_SIZE + lane] = 0u;
    }
    let first = min(tile * TILE + lane * RUN, length);
    let end = min(first + RUN, length);
    for (var ix = first; ix < end; ix++) {
        sh_places[digit_of(keys[ix], radix.shift) * WG_SIZE + lane]++;
    }
    workgroupBarrier();

    // This thread's share of one digit's counts.
    let digit = lane / SHARES;
    let counts = digit * WG_SIZE + lane % SHARES * SHARE;
    var sum = 0u;
    for (var c = counts; c < counts + SHARE; c++) {
        sum += sh_places[c];
    }
    sh_sums[lane] = sum;
    workgroupBarrier();
    var place = chunks[digit * n_tiles(length) + tile];
    for (var share = digit * SHARES; share < lane; share++) {
        place += sh_sums[share];
    }
    for (var c = counts; c < counts + SHARE; c++) {
        let n = sh_places[c];
        sh_places[c] = place;
        place += n;
    }
    workgroupBarrier();

    for (var ix = first; ix < end; ix++) {
        let key = keys[ix];
        let slot = digit_of(key, radix.shift) * WG_SIZE + lane;
        let to = sh_places[slot];
        sh_places[slot] = to + 1u;
        keys_out[to] = key;
        values_out[to] = values[ix];
    }
}
