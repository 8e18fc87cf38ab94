// sort, second of three in a pass, one workgroup: exclusive scan of the counts to the position of each tile's first
// entry per digit.
// radix: parameters. args: length. chunks: counts in, positions out.
#import sort
#import scan

@group(0) @binding(0) var<uniform> radix: SortPass;
@group(0) @binding(1) var<storage, read> args: array<u32>;
@group(0) @binding(2) var<storage, read_write> chunks: array<u32>;

@compute @workgroup_size(SCAN_SIZE)
fn sort_scan(@builtin(local_invocation_index) lane: u32) {
    scan(DIGITS * n_tiles(args[radix.args + 3u]), lane);
}
