// solve with separation, after a round: the largest potential of an unknown, the least one in liquid with a free surface, and the largest
// right-hand side, m/s.
// One thread per quad of the band.
// band_args, band_list: the band. flags: see active, without separated lanes. separated: see separation. potential, rhs: m/s.
// separation_sums: see separation.
#import active
#import dispatch
#import lanes
#import ordered
#import real
#import separation

@group(0) @binding(0) var<storage, read> band_args: array<u32>;
@group(0) @binding(1) var<storage, read> band_list: array<u32>;
@group(0) @binding(2) var<storage, read> flags: array<u32>;
@group(0) @binding(3) var<storage, read> separated: array<u32>;
@group(0) @binding(4) var<storage, read> potential: array<Real4>;
@group(0) @binding(5) var<storage, read> rhs: array<Real4>;
@group(0) @binding(6) var<storage, read_write> separation_sums: array<atomic<u32>>;

fn note_largest(word: u32, values: vec4<f32>, lanes: u32) {
    let bits = bitcast<vec4<u32>>(select(vec4<f32>(), abs(values), bit_lanes(lanes)));
    let largest = max(max(bits.x, bits.y), max(bits.z, bits.w));
    if largest > atomicLoad(&separation_sums[word]) {
        atomicMax(&separation_sums[word], largest);
    }
}

@compute @workgroup_size(WG_SIZE)
fn separation_scale(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let unknowns = flags[quad] & 15u;
    let all = unknowns | (separated[quad] & 15u);
    if all == 0u {
        return;
    }
    note_largest(LARGEST_POTENTIAL, vec4<f32>(potential[quad]), unknowns);
    let surface = all & ~(flags[quad] >> SURFACELESS);
    if surface != 0u {
        let p = select(vec4<f32>(), vec4<f32>(potential[quad]), bit_lanes(unknowns));
        let of_surface = select(vec4<f32>(bitcast<f32>(0x7f7fffffu)), p, bit_lanes(surface));
        let least = min(min(of_surface.x, of_surface.y), min(of_surface.z, of_surface.w));
        let word = ~ordered(least);
        if word > atomicLoad(&separation_sums[LEAST_POTENTIAL]) {
            atomicMax(&separation_sums[LEAST_POTENTIAL], word);
        }
    }
    note_largest(LARGEST_RHS, vec4<f32>(rhs[quad]), all);
}
