// Stage closed_components, with separation, after components_largest: the least value of a field in each closed component. One thread per RUN
// quads, which mostly belong to one component.
// settings: which word of the state. list: active quads. labels, state: see components. field: in.
// high: the least value at the root of each component, as the one's complement of its ordered bits: so zero comes before any value.
#import dispatch
#import level
#import components
#import fixed_point
#import ordered

@group(0) @binding(0) var<uniform> settings: vec4<u32>;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> labels: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> field: array<Real4>;
@group(0) @binding(4) var<storage, read> state: array<u32>;
@group(0) @binding(5) var<storage, read_write> high: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn components_least(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let first = RUN * linear_index(workgroup, lane);
    let end = min(first + RUN, state[QUADS]);
    if !has_range(state[settings.x]) {
        return;
    }
    var root = NONE;
    var least = 0u;
    for (var ix = first; ix < end; ix++) {
        let q = list[ix] & ~UNIFORM;
        let label = labels[q];
        let value = vec4<f32>(field[q]);
        for (var l = 0u; l < 4u; l++) {
            if (label[l] & OPEN) != 0u {
                continue;
            }
            if label[l] != root {
                if root != NONE {
                    atomicMax(&high[root], least);
                }
                root = label[l];
                least = 0u;
            }
            least = max(least, ~ordered(value[l]));
        }
    }
    if root != NONE {
        atomicMax(&high[root], least);
    }
}
