// Compaction, first of three: the number of non-zero flags in each chunk of 16.
// range: range of flags. flags: groups of four flags. chunks: counts.
#import dispatch
#import compact

@group(0) @binding(0) var<uniform> range: Range;
@group(0) @binding(1) var<storage, read> flags: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read_write> chunks: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn compact_count(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let chunk = linear_index(workgroup, lane);
    if chunk >= range.n_chunks {
        return;
    }
    var n = 0u;
    let first = range.first / 4u + chunk * CHUNK_GROUPS;
    let end = min(first + CHUNK_GROUPS, (range.first + range.n_flags) / 4u);
    for (var g = first; g < end; g++) {
        n += dot(vec4<u32>(flags[g] != vec4<u32>()), vec4<u32>(1u));
    }
    chunks[chunk] = n;
}
