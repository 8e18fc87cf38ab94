// Compaction, last of three: the indices of the non-zero flags, each with the highest bit of its flag.
// range: range of flags. flags: groups of four flags. chunks: index of each chunk's first entry. list: indices, from
// range.first.
#import dispatch
#import compact

@group(0) @binding(0) var<uniform> range: Range;
@group(0) @binding(1) var<storage, read> flags: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> chunks: array<u32>;
@group(0) @binding(3) var<storage, read_write> list: array<u32>;

const TAG = 0x80000000u;

@compute @workgroup_size(WG_SIZE)
fn compact_write(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let chunk = linear_index(workgroup, lane);
    if chunk >= range.n_chunks {
        return;
    }
    // Most chunks are empty when few flags are set.
    if chunk + 1u < range.n_chunks && chunks[chunk + 1u] == chunks[chunk] {
        return;
    }
    var at = range.first + chunks[chunk];
    let first = range.first / 4u + chunk * CHUNK_GROUPS;
    let end = min(first + CHUNK_GROUPS, (range.first + range.n_flags) / 4u);
    for (var g = first; g < end; g++) {
        let four = flags[g];
        for (var l = 0u; l < 4u; l++) {
            if four[l] != 0u {
                list[at] = (4u * g + l) | (four[l] & TAG);
                at++;
            }
        }
    }
}
