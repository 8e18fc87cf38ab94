// liquid_components: every liquid cell gets the index of the root of its component, its smallest cell. At the roots: no
// volume and no share yet.
// One thread per quad of the band.
// band_args, band_list: the band. labels: in place. component_sums, shares: see component_sums; out.
#import dispatch
#import find

@group(0) @binding(0) var<storage, read> band_args: array<u32>;
@group(0) @binding(1) var<storage, read> band_list: array<u32>;
@group(0) @binding(2) var<storage, read_write> labels: array<atomic<u32>>;
@group(0) @binding(3) var<storage, read_write> component_sums: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read_write> shares: array<vec2<u32>>;

@compute @workgroup_size(WG_SIZE)
fn label_roots(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let first = 4u * band_list[index];
    for (var cell = first; cell < first + 4u; cell++) {
        if atomicLoad(&labels[cell]) == 0u {
            continue;
        }
        let root = find(cell);
        if root == cell {
            component_sums[cell] = vec2<u32>();
            shares[cell] = vec2<u32>();
        } else {
            atomicStore(&labels[cell], root);
        }
    }
}
