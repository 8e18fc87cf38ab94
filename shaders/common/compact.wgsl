// Range of a compaction: gpu::Range on the host.
struct Range {
    first: u32,
    n_flags: u32,
    args: u32,
    n_chunks: u32,
}

// Flags per thread, in groups of four.
const CHUNK_GROUPS = 4u;
