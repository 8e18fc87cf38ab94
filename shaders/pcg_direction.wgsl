// PCG: s = z + beta s.
// level: level 0. list, args: active quads. scalars: see pcg. z: in. search: direction, in and out.
#import dispatch
#import level
#import pcg_slots
#import real

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> args: array<u32>;
@group(0) @binding(3) var<storage, read> scalars: array<Real>;
@group(0) @binding(4) var<storage, read> z: array<Real4>;
@group(0) @binding(5) var<storage, read_write> search: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn pcg_direction(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= args[level.args + 3u] {
        return;
    }
    let q = list[ix] & ~UNIFORM;
    search[q] = z[q] + scalars[BETA] * search[q];
}
