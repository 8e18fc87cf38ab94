// liquid_distance, last of five, with obstacles only: a cell without a distance takes the mean of its known face neighbours,
// weighted with the open fractions of the faces between. Three passes, each reading what the one before left.
// One thread per quad of the band; the band's neighbours count as unknown.
// level. args, list, flags: the band. open: fractions of the minus faces. distance_in, distance_out: m.
#import dispatch
#import layout
#import lanes
#import unknown

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> args: array<u32>;
@group(0) @binding(2) var<storage, read> list: array<u32>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> open: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> distance_in: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> distance_out: array<vec4<f32>>;

fn known_distance(quad: u32) -> vec4<f32> {
    if flags[quad] == 0u {
        return vec4<f32>(UNKNOWN);
    }
    return distance_in[quad];
}

// Weighted sum (x) and weights (y) over four lanes each.
struct Mean {
    sum: vec4<f32>,
    weight: vec4<f32>,
}

fn add(mean: Mean, phi: vec4<f32>, area: vec4<f32>) -> Mean {
    let known = phi < vec4<f32>(UNKNOWN);
    let weight = select(vec4<f32>(), area, known);
    return Mean(mean.sum + weight * select(vec4<f32>(), phi, known), mean.weight + weight);
}

@compute @workgroup_size(WG_SIZE)
fn extend_into_solids(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= args[3] {
        return;
    }
    let quad = list[index];
    var phi = distance_in[quad];
    let unknown = phi >= vec4<f32>(UNKNOWN);
    if any(unknown) {
        let sy = level.stride_y;
        let sz = level.stride_z;
        let y = level.quads + quad;
        let z = 2u * level.quads + quad;
        let ax = open[quad];
        var mean = Mean(vec4<f32>(), vec4<f32>());
        mean = add(mean, shift_up(known_distance(quad - 1u), phi), ax);
        mean = add(mean, shift_down(phi, known_distance(quad + 1u)), shift_down(ax, open[quad + 1u]));
        mean = add(mean, known_distance(quad - sy), open[y]);
        mean = add(mean, known_distance(quad + sy), open[y + sy]);
        mean = add(mean, known_distance(quad - sz), open[z]);
        mean = add(mean, known_distance(quad + sz), open[z + sz]);
        let found = unknown & (mean.weight > vec4<f32>());
        phi = select(phi, mean.sum / select(vec4<f32>(1.0), mean.weight, found), found);
    }
    distance_out[quad] = phi;
}
