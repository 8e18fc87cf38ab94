// What is ballistic about the centres and the minus faces of a quad, as is_ballistic_about, for all lanes at once.
// The importing kernel declares the variables of ballistic.
#import active
#import layout
#import step

// The cells of a row from four before to four behind a quad that are ballistic, and those that are filled and not, as bits.
fn row_kinds(quad: u32) -> vec2<u32> {
    let words = vec3<u32>(flags[quad - 1u], flags[quad], flags[quad + 1u]);
    let falls = words >> vec3<u32>(BALLISTIC) & vec3<u32>(15u);
    let rests = words >> vec3<u32>(FILLED) & ~falls & vec3<u32>(15u);
    return vec2<u32>(falls.x | falls.y << 4u | falls.z << 8u, rests.x | rests.y << 4u | rests.z << 8u);
}

// Lanes from their own bits and those before them; and those behind them.
fn with_before(kinds: vec2<u32>) -> u32 {
    let around = kinds >> vec2<u32>(4u) | kinds >> vec2<u32>(3u);
    return around.x & ~around.y & 15u;
}
fn with_both(kinds: vec2<u32>) -> u32 {
    let around = kinds >> vec2<u32>(4u) | kinds >> vec2<u32>(3u) | kinds >> vec2<u32>(5u);
    return around.x & ~around.y & 15u;
}

// The minus faces along x, y and z (bits 0 to 11) and the centres (bits 12 to 15) of the quad that starts at a cell.
fn falling(quad: u32, cell: vec3<i32>) -> u32 {
    let top = vec3<i32>(level.cells) - 1;
    // Rows beyond a wall have no liquid; the own one stands for them.
    let below = select(0u, level.stride_y, cell.y > 0);
    let above = select(0u, level.stride_y, cell.y < top.y);
    let behind = select(0u, level.stride_z, cell.z > 0);
    let front = select(0u, level.stride_z, cell.z < top.z);
    // Per slab: the own row with the one below, and with both.
    var two: array<vec2<u32>, 3>;
    var three: array<vec2<u32>, 3>;
    let slabs = array<u32, 3>(quad - behind, quad, quad + front);
    for (var slab = 0u; slab < 3u; slab++) {
        let row = slabs[slab];
        two[slab] = row_kinds(row) | row_kinds(row - below);
        three[slab] = two[slab] | row_kinds(row + above);
    }
    let slab_pair = three[0] | three[1];
    let all_rows = slab_pair | three[2];
    let found = with_before(all_rows) | with_both(two[0] | two[1] | two[2]) << 4u | with_both(slab_pair) << 8u
        | with_both(all_rows) << 12u;
    return select(0u, found, step.n_markers != 0u);
}
