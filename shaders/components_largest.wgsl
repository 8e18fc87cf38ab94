// Stage closed_components, before the sums: the largest magnitude of a field in closed components, and zero sums at their roots. One thread
// per RUN quads.
// settings: which word of the state. list: active quads. labels, state: see components. field: in.
// high, middle, low: words of the sum over a component, at its root. count: its cells, likewise.
#import dispatch
#import level
#import components
#import real

@group(0) @binding(0) var<uniform> settings: vec4<u32>;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> labels: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> field: array<Real4>;
@group(0) @binding(4) var<storage, read_write> state: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read_write> high: array<u32>;
@group(0) @binding(6) var<storage, read_write> middle: array<u32>;
@group(0) @binding(7) var<storage, read_write> low: array<u32>;
@group(0) @binding(8) var<storage, read_write> count: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn components_largest(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let first = RUN * linear_index(workgroup, lane);
    let end = min(first + RUN, atomicLoad(&state[QUADS]));
    var largest = 0.0;
    for (var ix = first; ix < end; ix++) {
        let q = list[ix] & ~UNIFORM;
        let label = labels[q];
        let magnitude = vec4<f32>(abs(field[q]));
        for (var l = 0u; l < 4u; l++) {
            if (label[l] & OPEN) != 0u {
                continue;
            }
            largest = max(largest, magnitude[l]);
            let cell = 4u * q + l;
            if label[l] == cell {
                high[cell] = 0u;
                middle[cell] = 0u;
                low[cell] = 0u;
                count[cell] = 0u;
            }
        }
    }
    if largest > 0.0 {
        // The bits of positive numbers are in the order of their values.
        atomicMax(&state[settings.x], bitcast<u32>(largest));
    }
}
