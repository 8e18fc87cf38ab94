// solve with separation, after a round: its potential as the guess of the next one (see refine). One thread per quad of the band.
// level: level 0. band_args, band_list: the band. flags: see active, without separated lanes. potential: m/s. search: the correction, out.
#import dispatch
#import inner
#import lanes
#import level
#import real

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> potential: array<Real4>;
@group(0) @binding(5) var<storage, read_write> search: array<Inner4>;

@compute @workgroup_size(WG_SIZE)
fn separation_guess(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    search[level.shape.quads + quad] = Inner4(select(Real4(), potential[quad], bit_lanes(flags[quad])));
}
