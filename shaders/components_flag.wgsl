// Stage closed_components, only where some have no free surface or touch nothing: every cell gets the label of its root, and
// its quad a flag if the component is closed, another if it is closed or sealed, another if it is ballistic.
// list: active quads. state: see components. labels: in and out, see components. flags: in and out, see active.
#import active
#import dispatch
#import level
#import find

@group(0) @binding(0) var<storage, read> list: array<u32>;
@group(0) @binding(1) var<storage, read> state: array<u32>;
@group(0) @binding(2) var<storage, read_write> labels: array<atomic<u32>>;
@group(0) @binding(3) var<storage, read_write> flags: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn components_flag(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= state[QUADS] {
        return;
    }
    let entry = list[ix];
    let q = entry & ~UNIFORM;
    let flag = atomicLoad(&flags[q]);
    var found = 0u;
    var label = NONE;
    var falls = 0u;
    for (var l = 0u; l < 4u; l++) {
        if (flag & (1u << l)) == 0u {
            continue;
        }
        // The cells of a uniform quad are joined.
        if l == 0u || (entry & UNIFORM) == 0u {
            let root = find(4u * q + l);
            label = root | (atomicLoad(&labels[root]) & MARKS);
            falls = ~(atomicLoad(&flags[root / 4u]) >> (HELD_ROOT + root % 4u)) & 1u;
        }
        atomicStore(&labels[4u * q + l], label);
        if (label & OPEN) == 0u {
            found |= (1u << CLOSED | 1u << SURFACELESS) << l;
        } else if (label & SEALED) != 0u {
            found |= (1u << SURFACELESS) << l;
        }
        found |= falls << (BALLISTIC + l);
    }
    if found != 0u {
        atomicOr(&flags[q], found);
    }
}
