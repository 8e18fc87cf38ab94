// liquid_distance, second of five: flags the markers near empty cells, and packs the classes of the cells around a
// quad into one word.
// Clears the markers' flags for the next sub-step. One thread per quad of the band.
// level. band_args, band_list: the band. classes: see classes. occupied: in place.
#import dispatch
#import layout
#import classes

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> classes: array<u32>;
@group(0) @binding(4) var<storage, read_write> occupied: array<u32>;

fn near_lanes(quad: u32) -> u32 {
    // The diagonal row before the first one is before the array; spare cells need no marker.
    if quad >= level.quads {
        return 0u;
    }
    return lanes_of(classes[quad], NEAR);
}

// Eight cells along x from the second before the quad.
fn row_of(before: u32, here: u32, after: u32, kind: u32) -> u32 {
    return lanes_of(before, kind) >> 2u | lanes_of(here, kind) << 2u | (lanes_of(after, kind) & 3u) << 6u;
}

@compute @workgroup_size(WG_SIZE)
fn classify_far(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let word = occupied[quad];
    let marked = lanes_of(word, MARKED);
    var spreading = near_lanes(quad);
    if marked != 0u && spreading != 15u {
        var before = 0u;
        var here = 0u;
        var after = 0u;
        for (var s = 0u; s < 3u; s++) {
            for (var r = 0u; r < 3u; r++) {
                let row = quad + s * level.stride_z + r * level.stride_y - level.stride_z - level.stride_y;
                before |= near_lanes(row - 1u);
                here |= near_lanes(row);
                after |= near_lanes(row + 1u);
            }
        }
        spreading = dilate_row(before, here, after);
    }
    let before = classes[quad - 1u];
    let here = classes[quad];
    let after = classes[quad + 1u];
    occupied[quad] = lanes_of(word, NO_ROOM) << NO_ROOM | (spreading & marked) << SPREADING
        | row_of(before, here, after, WANTING) << WANTING_ROW | row_of(before, here, after, EMPTY) << EMPTY_ROW;
}
