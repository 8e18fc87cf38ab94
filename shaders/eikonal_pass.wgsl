// redistance, one of nine passes: |grad D| = 1, first order, from the smaller neighbour along each axis (Rouy and Tourin
// 1992). Paths lead through bodies, where the surface continues, but not out of the domain.
// Distances only decrease from the cap on, so that a quad whose cells and neighbours are at the cap leaves distance_out
// as it is: at the cap. One thread per quad of the band; cells outside it are at the cap.
// level. band_args, band_list, band_flags: the band. distance_in, distance_out: cells, with a minus where they stay.
#import dispatch
#import lanes
#import layout
#import level_values

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> band_flags: array<u32>;
@group(0) @binding(4) var<storage, read> distance_in: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> distance_out: array<vec4<f32>>;

// The distances in a quad, which may be outside the band or the domain.
fn distances(quad: u32, value: vec4<f32>, inside: bool) -> vec4<f32> {
    return select(vec4<f32>(REACH), value, inside && band_flags[quad] != 0u);
}
fn distance(quad: u32, value: f32, inside: bool) -> f32 {
    return select(REACH, value, inside && band_flags[quad] != 0u);
}

fn squares(values: vec4<f32>) -> vec4<f32> {
    return values * values;
}

// The solution from the smallest distance along each axis.
fn eikonal(x: vec4<f32>, y: vec4<f32>, z: vec4<f32>) -> vec4<f32> {
    let a = min(min(x, y), z);
    let b = max(min(x, y), min(max(x, y), z));
    let c = max(max(x, y), z);
    let one = a + 1.0;
    let difference = squares(b - a);
    let two = 0.5 * (a + b + sqrt(max(2.0 - difference, vec4<f32>())));
    let differences = difference + squares(c - b) + squares(c - a);
    let three = (a + b + c + sqrt(max(3.0 - differences, vec4<f32>()))) / 3.0;
    let plane = select(one, two, one > b);
    return min(select(plane, three, plane > c), vec4<f32>(REACH));
}

@compute @workgroup_size(WG_SIZE)
fn eikonal_pass(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let word = distance_in[quad];
    let here = abs(word);
    let before = abs(distance_in[quad - 1u].w);
    let after = abs(distance_in[quad + 1u].x);
    let y = vec2<u32>(quad - level.stride_y, quad + level.stride_y);
    let z = vec2<u32>(quad - level.stride_z, quad + level.stride_z);
    let below = abs(distance_in[y.x]);
    let above = abs(distance_in[y.y]);
    let behind = abs(distance_in[z.x]);
    let front = abs(distance_in[z.y]);
    let nearest = min(min(min(below, above), min(behind, front)), min(here, vec4<f32>(min(before, after))));
    if all(nearest >= vec4<f32>(REACH)) {
        return;
    }
    let cell = quad_cell(level, quad);
    let n = vec3<i32>(level.cells);
    let exists = lanes_inside(cell, n);
    let own = select(vec4<f32>(REACH), here, exists);
    let x = min(vec4<f32>(distance(quad - 1u, before, cell.x > 0), own.xyz),
        vec4<f32>(own.yzw, distance(quad + 1u, after, cell.x + 4 < n.x)));
    let along_y = min(distances(y.x, below, cell.y > 0), distances(y.y, above, cell.y + 1 < n.y));
    let along_z = min(distances(z.x, behind, cell.z > 0), distances(z.y, front, cell.z + 1 < n.z));
    let next = select(vec4<f32>(REACH), eikonal(x, along_y, along_z), exists);
    distance_out[quad] = select(next, word, word < vec4<f32>());
}
