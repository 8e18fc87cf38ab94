// Compaction, second of three, one workgroup: chunk counts become the index of each chunk's first entry; the dispatch size
// and the length of the list go to args.
// range: where to look. chunks: counts in, offsets out. args: workgroups x, y, z, length.
#import dispatch
#import compact

@group(0) @binding(0) var<uniform> range: Range;
@group(0) @binding(1) var<storage, read_write> chunks: array<u32>;
@group(0) @binding(2) var<storage, read_write> args: array<u32>;

const SCAN_SIZE = 256u;
var<workgroup> sh_sums: array<u32, SCAN_SIZE>;

@compute @workgroup_size(SCAN_SIZE)
fn compact_scan(@builtin(local_invocation_index) lane: u32) {
    let share = (range.n_chunks + SCAN_SIZE - 1u) / SCAN_SIZE;
    let first = min(lane * share, range.n_chunks);
    let end = min(first + share, range.n_chunks);
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
    if lane == SCAN_SIZE - 1u {
        let groups = workgroups_for(sh_sums[lane]);
        args[range.args] = groups.x;
        args[range.args + 1u] = groups.y;
        args[range.args + 2u] = groups.z;
        args[range.args + 3u] = sh_sums[lane];
    }
}
