// liquid_distance, first of five: the class of every cell of the band, and the initial squared distance to the
// nearest marker.
// One thread per quad.
// level. band_args, band_list: the band. occupied: see classes. classes: out. squares: squared distance to the
// nearest marker, cells^2.
#import dispatch
#import layout
#import classes

// Square of the largest distance of a marker that counts, 2 cells.
const REACH_SQUARED = 4.0;

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> occupied: array<u32>;
@group(0) @binding(4) var<storage, read_write> classes: array<u32>;
@group(0) @binding(5) var<storage, read_write> squares: array<vec4<f32>>;

fn empty_lanes(quad: u32) -> u32 {
    // The diagonal row before the first one is before the array; spare cells are not empty.
    if quad >= level.quads {
        return 0u;
    }
    let word = occupied[quad];
    return lanes_of(~(word | word >> MARKED), NO_ROOM);
}

@compute @workgroup_size(WG_SIZE)
fn classify_near(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let room = lanes_of(~occupied[quad], NO_ROOM);
    let empty = empty_lanes(quad);
    var near = 15u;
    if empty != 15u {
        var before = 0u;
        var here = 0u;
        var after = 0u;
        for (var s = 0u; s < 3u; s++) {
            for (var r = 0u; r < 3u; r++) {
                let row = quad + s * level.stride_z + r * level.stride_y - level.stride_z - level.stride_y;
                before |= empty_lanes(row - 1u);
                here |= empty_lanes(row);
                after |= empty_lanes(row + 1u);
            }
        }
        near = dilate_row(before, here, after);
    }
    classes[quad] = empty << EMPTY | near << NEAR | (near & room) << WANTING;
    squares[quad] = vec4<f32>(REACH_SQUARED);
}
