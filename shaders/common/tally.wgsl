// Adds the values of a workgroup's cells to the sums of their components (see component_sums). The cells of a workgroup
// mostly belong to one component: its values are added up in the workgroup first, so that a large component gets one
// addition per workgroup.
// The importing kernel declares sums: array<atomic<u32>>. All threads must call tally.
#import component_sums

var<workgroup> sh_label: atomic<u32>;
var<workgroup> sh_low: atomic<u32>;
var<workgroup> sh_high: atomic<u32>;

// The word before an addition tells whether this addition overflowed it; carries are as many in any order.
fn add_at(label: u32, sum: vec2<u32>) {
    let carry = u32(atomicAdd(&sums[2u * label], sum.x) > ~sum.x);
    let high = sum.y + carry;
    if high != 0u {
        atomicAdd(&sums[2u * label + 1u], high);
    }
}

// value: volumes of cells; no part in any sum where the label is 0.
fn tally(label: vec4<u32>, value: vec4<f32>, lane: u32) {
    let largest = max(max(label.x, label.y), max(label.z, label.w));
    if largest > 0u {
        atomicMax(&sh_label, largest);
    }
    workgroupBarrier();
    let most = atomicLoad(&sh_label);
    var sum = vec2<u32>();
    for (var l = 0u; l < 4u; l++) {
        if label[l] == 0u || value[l] == 0.0 {
            continue;
        }
        let part = fixed(value[l]);
        if label[l] == most {
            sum = add64(sum, part);
        } else {
            add_at(label[l], part);
        }
    }
    if any(sum != vec2<u32>()) {
        let carry = u32(atomicAdd(&sh_low, sum.x) > ~sum.x);
        atomicAdd(&sh_high, sum.y + carry);
    }
    workgroupBarrier();
    if lane == 0u && most > 0u {
        let whole = vec2<u32>(atomicLoad(&sh_low), atomicLoad(&sh_high));
        if any(whole != vec2<u32>()) {
            add_at(most, whole);
        }
    }
}
