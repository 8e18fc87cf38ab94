#import real

// Sum over FOLD_SIZE threads of a workgroup, in a tree. All threads must call it, with a barrier between two calls.
const FOLD_SIZE = 256u;
var<workgroup> sh_sums: array<Real4, FOLD_SIZE>;

fn tree(part: Real4, lane: u32) -> Real4 {
    sh_sums[lane] = part;
    for (var half = FOLD_SIZE / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            sh_sums[lane] += sh_sums[lane + half];
        }
    }
    workgroupBarrier();
    return sh_sums[0];
}
