// solve with separation, last: potential 0 in separated cells, and marks of the cells whose walls liquid leaves: air and
// separated ones (see valid). One thread per quad of the band.
// band_args, band_list: the band. flags: see active, with separated lanes. separated: see separation. potential: m/s, in place.
// valid: in place. projected: active lanes that do not separate; out.
#import dispatch
#import lanes
#import real
#import separation
#import valid

@group(0) @binding(0) var<storage, read> band_args: array<u32>;
@group(0) @binding(1) var<storage, read> band_list: array<u32>;
@group(0) @binding(2) var<storage, read> flags: array<u32>;
@group(0) @binding(3) var<storage, read> separated: array<u32>;
@group(0) @binding(4) var<storage, read_write> potential: array<Real4>;
@group(0) @binding(5) var<storage, read_write> valid: array<u32>;
@group(0) @binding(6) var<storage, read_write> projected: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn separation_settle(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let now = separated[quad] & 15u;
    if now != 0u {
        potential[quad] = select(potential[quad], Real4(), bit_lanes(now));
    }
    let holds = flags[quad] & 15u & ~now;
    projected[quad] = holds;
    valid[quad] = (valid[quad] & ~LEAVING) | (~holds & 15u) << LEAVING_FIRST;
}
