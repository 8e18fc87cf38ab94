// redistance, first: the distance at interface cells, |phi|, at the others its cap. An interface cell has an open
// neighbour of the other sign; its distance stays and is stored with a minus. One thread per quad of the band; outside
// it there is air.
// level. band_args, band_list, band_flags: the band. valid, occupied: see level_cells. new_level: cells, unknown
// deep in bodies. eikonal_now, eikonal_next: the distance, cells, out.
#import dispatch
#import layout
#import level_values
#import quad_rooms

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> band_flags: array<u32>;
@group(0) @binding(4) var<storage, read> valid: array<u32>;
@group(0) @binding(5) var<storage, read> occupied: array<u32>;
@group(0) @binding(6) var<storage, read> new_level: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> eikonal_now: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> eikonal_next: array<vec4<f32>>;

// In place of zero, which has no sign.
const LEAST = 1e-30;

fn liquid(quad: u32) -> u32 {
    return select(0u, lane_bits(new_level[quad] < vec4<f32>()), band_flags[quad] != 0u);
}

fn liquid_lane(quad: u32, lane: u32) -> u32 {
    return u32(band_flags[quad] != 0u && new_level[quad][lane] < 0.0);
}

// Lanes at the interface: with a side to a neighbour of the other sign.
fn interface_lanes(quad: u32, here: u32) -> u32 {
    let around = (here << 1u & 15u) | liquid_lane(quad - 1u, 3u) | (here >> 1u | liquid_lane(quad + 1u, 0u) << 3u) << 4u
        | liquid(quad - level.stride_y) << 8u | liquid(quad + level.stride_y) << 12u
        | liquid(quad - level.stride_z) << 16u | liquid(quad + level.stride_z) << 20u;
    let differs = (around ^ here * 0x111111u) & rooms_beside(quad);
    let halves = differs | differs >> 12u;
    return (halves | halves >> 4u | halves >> 8u) & rooms(quad);
}

@compute @workgroup_size(WG_SIZE)
fn start_redistance(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let phi = new_level[quad];
    let interface_here = bit_lanes(interface_lanes(quad, lane_bits(phi < vec4<f32>())));
    let distance = select(vec4<f32>(REACH), -clamp(abs(phi), vec4<f32>(LEAST), vec4<f32>(REACH)), interface_here);
    eikonal_now[quad] = distance;
    eikonal_next[quad] = distance;
}
