// redistance, one of nine passes: |grad D| = 1, first order, from the smaller neighbour along each axis (Rouy and Tourin
// 1992). Neighbours are across open faces, in bodies too; beyond closed faces and walls a cell is its own neighbour.
// Distances only decrease from the cap on, so that a quad whose cells and neighbours are at the cap leaves distance_out
// as it is: at the cap. One thread per quad of the band; cells outside it are at the cap.
// level. band_args, band_list, band_flags: the band. open: apertures of the minus faces. distance_in, distance_out:
// cells, with a minus where they stay.
#import dispatch
#import lanes
#import layout
#import level_values

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> band_flags: array<u32>;
@group(0) @binding(4) var<storage, read> open: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> distance_in: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> distance_out: array<vec4<f32>>;

// The distances in a quad, which may be outside the band.
fn distances(quad: u32, value: vec4<f32>) -> vec4<f32> {
    return select(vec4<f32>(REACH), value, band_flags[quad] != 0u);
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
    let before = abs(distance_in[quad - 1u]);
    let after = abs(distance_in[quad + 1u]);
    let y = vec2<u32>(quad - level.stride_y, quad + level.stride_y);
    let z = vec2<u32>(quad - level.stride_z, quad + level.stride_z);
    let below = abs(distance_in[y.x]);
    let above = abs(distance_in[y.y]);
    let behind = abs(distance_in[z.x]);
    let front = abs(distance_in[z.y]);
    let nearest = min(min(min(below, above), min(behind, front)), min(here, vec4<f32>(min(before.w, after.x))));
    if all(nearest >= vec4<f32>(REACH)) {
        return;
    }
    let cell = quad_cell(level, quad);
    let n = vec3<i32>(level.cells);
    let lanes_x = vec4<i32>(cell.x) + LANES;
    let closed = vec4<f32>();
    let face_x = open[quad];
    let face_y = level.quads;
    let face_z = 2u * level.quads;
    let open_minus_x = (face_x > closed) & (lanes_x > vec4<i32>());
    let open_plus_x = (shift_down(face_x, open[quad + 1u]) > closed) & (lanes_x + 1 < vec4<i32>(n.x));
    let open_minus_y = (open[face_y + quad] > closed) & vec4<bool>(cell.y > 0);
    let open_plus_y = (open[face_y + y.y] > closed) & vec4<bool>(cell.y + 1 < n.y);
    let open_minus_z = (open[face_z + quad] > closed) & vec4<bool>(cell.z > 0);
    let open_plus_z = (open[face_z + z.y] > closed) & vec4<bool>(cell.z + 1 < n.z);
    let x = min(select(here, shift_up(distances(quad - 1u, before), here), open_minus_x),
        select(here, shift_down(here, distances(quad + 1u, after)), open_plus_x));
    let along_y = min(select(here, distances(y.x, below), open_minus_y),
        select(here, distances(y.y, above), open_plus_y));
    let along_z = min(select(here, distances(z.x, behind), open_minus_z),
        select(here, distances(z.y, front), open_plus_z));
    let next = select(vec4<f32>(REACH), eikonal(x, along_y, along_z), lanes_inside(cell, n));
    distance_out[quad] = select(next, word, word < vec4<f32>());
}
