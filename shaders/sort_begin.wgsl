// sort, before its passes, one thread: number of workgroups for the tiles of the list.
// radix: parameters. args: arguments of the list. tile_args: workgroups x, y, z.
#import sort

@group(0) @binding(0) var<uniform> radix: SortPass;
@group(0) @binding(1) var<storage, read> args: array<u32>;
@group(0) @binding(2) var<storage, read_write> tile_args: array<u32>;

@compute @workgroup_size(1)
fn sort_begin() {
    // A workgroup per tile has WG_SIZE threads.
    let groups = workgroups_for(n_tiles(args[radix.args + 3u]) * WG_SIZE);
    tile_args[0] = groups.x;
    tile_args[1] = groups.y;
    tile_args[2] = groups.z;
}
