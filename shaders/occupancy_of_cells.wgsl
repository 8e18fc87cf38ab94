// occupancy, last of two: F = W / (8 T), the fraction of a cell's surroundings that markers fill, W the sum of their
// weights. F is unknown where T < 0.2, and at least 1 deep below the surface.
// T is the open part of the tent around the cell: 1 away from bodies, beside them the sum over 64 eighths of cells,
// each with the open fraction at its centre. Afterwards the sums are zero. One thread per quad of the band; all weights are in it.
// level, step. band_args, band_list: the band. marker_weights: in units of 2^-20, in place. carried_level: cells.
// solid_distance: m, cell centres; one quad far outside in a scene without bodies. occupancy: out.
#import dispatch
#import lanes
#import layout
#import level_values
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read_write> marker_weights: array<vec4<u32>>;
@group(0) @binding(5) var<storage, read> carried_level: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> solid_distance: array<f32>;
@group(0) @binding(7) var<storage, read_write> occupancy: array<vec4<f32>>;

// The constants of reference/occupancy.rs.
// Fixed point of the weights.
const ONE = 1048576.0;
// Markers of a full cell.
const PER_CELL = 8.0;
// Least open part of the surroundings of a cell with a known occupancy.
const LEAST_OPEN = 0.2;
// Depth below which cells count as full, cells.
const FULL_BELOW = 1.5;
// Distance of a body that closes all or nothing of the tent, cells.
const FAR = 2.0;

// Distances at the centres of the four eighths along x of a row, 1/4 and 3/4 of a cell from the centre of the middle
// one. The row and its cells are those at the wall beyond it.
fn along_row(at: vec3<i32>) -> vec4<f32> {
    let top = vec3<i32>(level.cells) - 1;
    let row = vec2<u32>(clamp(at.yz, vec2<i32>(), top.yz));
    let first = 4u * (level.stride_z * (row.y + 1u) + level.stride_y * row.x);
    let before = solid_distance[first + u32(max(at.x - 1, 0))];
    let here = solid_distance[first + u32(at.x)];
    let after = solid_distance[first + u32(min(at.x + 1, top.x))];
    let quarters = vec4<f32>(0.25, 0.75, 0.25, 0.75);
    return mix(vec4<f32>(before, before, here, here), vec4<f32>(here, here, after, after), quarters);
}

// The second or third eighth along an axis has three times the part of the tent of the first or last.
fn part(eighth: u32) -> f32 {
    return select(0.125, 0.375, eighth == 1u || eighth == 2u);
}

fn open_surroundings(at: vec3<i32>) -> f32 {
    // Per slab and eighth along y: distances along x.
    var slabs: array<vec4<f32>, 12>;
    for (var slab = 0; slab < 3; slab++) {
        let below = along_row(at + vec3<i32>(0, -1, slab - 1));
        let here = along_row(at + vec3<i32>(0, 0, slab - 1));
        let above = along_row(at + vec3<i32>(0, 1, slab - 1));
        slabs[4 * slab] = mix(below, here, 0.25);
        slabs[4 * slab + 1] = mix(below, here, 0.75);
        slabs[4 * slab + 2] = mix(here, above, 0.25);
        slabs[4 * slab + 3] = mix(here, above, 0.75);
    }
    let parts = vec4<f32>(part(0u), part(1u), part(2u), part(3u));
    var sum = 0.0;
    for (var z = 0u; z < 4u; z++) {
        let first = 4u * (z / 2u);
        let fraction = select(0.25, 0.75, z % 2u == 1u);
        for (var y = 0u; y < 4u; y++) {
            let distance = mix(slabs[first + y], slabs[first + 4u + y], fraction);
            let open = clamp(0.5 + 2.0 * step.inv_dx * distance, vec4<f32>(), vec4<f32>(1.0));
            sum += part(y) * part(z) * dot(open, parts);
        }
    }
    return sum;
}

@compute @workgroup_size(WG_SIZE)
fn occupancy_of_cells(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let first_cell = quad_cell(level, quad);
    let exists = lanes_inside(first_cell, vec3<i32>(level.cells));
    let far = FAR * step.dx;
    let last = arrayLength(&solid_distance) - 1u;
    var open = vec4<f32>(1.0);
    var beside = 0u;
    for (var n = 0u; n < 4u; n++) {
        let distance = solid_distance[min(4u * quad + n, last)];
        if distance <= -far {
            open[n] = 0.0;
        } else if distance < far && exists[n] {
            beside |= 1u << n;
        }
    }
    while beside != 0u {
        let n = firstTrailingBit(beside);
        beside &= beside - 1u;
        open[n] = open_surroundings(first_cell + vec3<i32>(i32(n), 0, 0));
    }
    let known = open >= vec4<f32>(LEAST_OPEN);
    let fraction = vec4<f32>(marker_weights[quad]) / (ONE * PER_CELL * max(open, vec4<f32>(LEAST_OPEN)));
    let here = select(vec4<f32>(UNKNOWN_OCCUPANCY), fraction, known);
    let deep = carried_level[quad] < vec4<f32>(-FULL_BELOW);
    marker_weights[quad] = vec4<u32>();
    occupancy[quad] = select(vec4<f32>(), select(here, max(here, vec4<f32>(1.0)), deep), exists);
}
