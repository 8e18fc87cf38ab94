// Stage closed_components: takes the mean over each closed component, or its least value, out of a field.
// settings: which word of the state; 1 for the least value, see components_least. list: active quads. labels, state: see components.
// field: in and out.
// high, middle, low: words of the sum over a component, at its root. count: its cells, likewise.
#import dispatch
#import level
#import components
#import fixed_point
#import ordered

@group(0) @binding(0) var<uniform> settings: vec4<u32>;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> labels: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read_write> field: array<Real4>;
@group(0) @binding(4) var<storage, read> state: array<u32>;
@group(0) @binding(5) var<storage, read> high: array<u32>;
@group(0) @binding(6) var<storage, read> middle: array<u32>;
@group(0) @binding(7) var<storage, read> low: array<u32>;
@group(0) @binding(8) var<storage, read> count: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn components_subtract(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    let bits = state[settings.x];
    if ix >= state[QUADS] || !has_range(bits) {
        return;
    }
    let q = list[ix] & ~UNIFORM;
    let label = labels[q];
    if all((label & vec4<u32>(OPEN)) != vec4<u32>()) {
        return;
    }
    var value = field[q];
    for (var l = 0u; l < 4u; l++) {
        let root = label[l];
        if (root & OPEN) == 0u {
            if settings.y != 0u {
                value[l] -= Real(from_ordered(~high[root]));
                continue;
            }
            let mean = from96(vec3<u32>(high[root], middle[root], low[root]), bits) / Real(count[root]);
            let rest = value[l] - mean;
            // What is left of a value equal to the mean is rounding.
            value[l] = select(rest, Real(0.0), abs(rest) <= Real(2.0) * EPSILON * abs(mean));
        }
    }
    field[q] = value;
}
