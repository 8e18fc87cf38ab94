// Stage closed_components: the sum of a field over each closed component and the number of its cells, in integers, so that the order of
// the atomics does not matter. One thread per RUN quads, which mostly belong to one component.
// settings: which word of the state. list: active quads. labels, state: see components. field: in.
// high, middle, low: words of the sum over a component, at its root. count: its cells, likewise.
#import dispatch
#import level
#import components
#import fixed_point

@group(0) @binding(0) var<uniform> settings: vec4<u32>;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> labels: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> field: array<Real4>;
@group(0) @binding(4) var<storage, read> state: array<u32>;
@group(0) @binding(5) var<storage, read_write> high: array<atomic<u32>>;
@group(0) @binding(6) var<storage, read_write> middle: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> low: array<atomic<u32>>;
@group(0) @binding(8) var<storage, read_write> count: array<atomic<u32>>;

fn flush(root: u32, sum: vec3<u32>, cells: u32) {
    if cells == 0u {
        return;
    }
    // The word before an addition tells whether this addition overflowed it; carries are as many in any order.
    var carry = u32(atomicAdd(&low[root], sum.z) > ~sum.z);
    let with_carry = sum.y + carry;
    carry = u32(with_carry < carry) + u32(atomicAdd(&middle[root], with_carry) > ~with_carry);
    atomicAdd(&high[root], sum.x + carry);
    atomicAdd(&count[root], cells);
}

@compute @workgroup_size(WG_SIZE)
fn components_sum(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let first = RUN * linear_index(workgroup, lane);
    let end = min(first + RUN, state[QUADS]);
    let bits = state[settings.x];
    if !has_range(bits) {
        return;
    }
    var root = NONE;
    var sum = vec3<u32>();
    var cells = 0u;
    for (var ix = first; ix < end; ix++) {
        let q = list[ix] & ~UNIFORM;
        let label = labels[q];
        let value = field[q];
        for (var l = 0u; l < 4u; l++) {
            if (label[l] & OPEN) != 0u {
                continue;
            }
            if label[l] != root {
                flush(root, sum, cells);
                root = label[l];
                sum = vec3<u32>();
                cells = 0u;
            }
            sum = add96(sum, to96(value[l], bits));
            cells++;
        }
    }
    flush(root, sum, cells);
}
