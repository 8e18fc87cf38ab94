// Compaction, second of three, one workgroup: exclusive scan of the chunk counts; writes the dispatch size and the
// length of the list.
// range: range of flags. chunks: counts in, offsets out. args: workgroups x, y, z, length.
#import dispatch
#import compact
#import scan

@group(0) @binding(0) var<uniform> range: Range;
@group(0) @binding(1) var<storage, read_write> chunks: array<u32>;
@group(0) @binding(2) var<storage, read_write> args: array<u32>;

@compute @workgroup_size(SCAN_SIZE)
fn compact_scan(@builtin(local_invocation_index) lane: u32) {
    let length = scan(range.n_chunks, lane);
    if lane == 0u {
        let groups = workgroups_for(length);
        args[range.args] = groups.x;
        args[range.args + 1u] = groups.y;
        args[range.args + 2u] = groups.z;
        args[range.args + 3u] = length;
    }
}
