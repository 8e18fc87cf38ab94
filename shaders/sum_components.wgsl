// liquid_components: sums over all components. One thread per quad of the band.
// band_args, band_list: the band. component: labels. component_sums, shares: volumes and shares at the roots, see
// component_sums. component_totals: two words of the volumes, two of the shares.
#import component_sums
#import dispatch

@group(0) @binding(0) var<storage, read> band_args: array<u32>;
@group(0) @binding(1) var<storage, read> band_list: array<u32>;
@group(0) @binding(2) var<storage, read> component: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> component_sums: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> shares: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read_write> component_totals: array<atomic<u32>>;

// The totals of the workgroup.
var<workgroup> sh_totals: array<atomic<u32>, 4>;

fn add_here(total: u32, sum: vec2<u32>) {
    let carry = u32(atomicAdd(&sh_totals[total], sum.x) > ~sum.x);
    atomicAdd(&sh_totals[total + 1u], sum.y + carry);
}

fn add_to_all(total: u32) {
    let sum = vec2<u32>(atomicLoad(&sh_totals[total]), atomicLoad(&sh_totals[total + 1u]));
    if any(sum != vec2<u32>()) {
        let carry = u32(atomicAdd(&component_totals[total], sum.x) > ~sum.x);
        atomicAdd(&component_totals[total + 1u], sum.y + carry);
    }
}

@compute @workgroup_size(WG_SIZE)
fn sum_components(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index < band_args[3] {
        let quad = band_list[index];
        let label = component[quad];
        for (var l = 0u; l < 4u; l++) {
            let cell = 4u * quad + l;
            if label[l] == cell {
                let volume = component_sums[cell];
                add_here(0u, vec2<u32>(volume.x, volume.y & ~SURFACE));
                add_here(2u, shares[cell]);
            }
        }
    }
    workgroupBarrier();
    if lane == 0u {
        add_to_all(0u);
        add_to_all(2u);
    }
}
