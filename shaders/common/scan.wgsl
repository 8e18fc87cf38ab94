// Exclusive scan of chunks[0 .. n] in place by one workgroup of SCAN_SIZE threads; returns the sum to each. The
// importing kernel declares chunks. All threads must call it.
const SCAN_SIZE = 256u;
var<workgroup> sh_sums: array<u32, SCAN_SIZE>;

fn scan(n: u32, lane: u32) -> u32 {
    let share = (n + SCAN_SIZE - 1u) / SCAN_SIZE;
    let first = min(lane * share, n);
    let end = min(first + share, n);
    var sum = 0u;
    for (var c = first; c < end; c++) {
        sum += chunks[c];
    }
    sh_sums[lane] = sum;
    for (var step = 1u; step < SCAN_SIZE; step *= 2u) {
        workgroupBarrier();
        var below = 0u;
        if lane >= step {
            below = sh_sums[lane - step];
        }
        workgroupBarrier();
        sh_sums[lane] += below;
    }
    var offset = sh_sums[lane] - sum;
    for (var c = first; c < end; c++) {
        let n = chunks[c];
        chunks[c] = offset;
        offset += n;
    }
    workgroupBarrier();
    return sh_sums[SCAN_SIZE - 1u];
}
