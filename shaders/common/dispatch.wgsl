// Threads of list kernels: a linear index over a dispatch that is split in two dimensions above SPLIT workgroups.
// Also gpu::SPLIT and gpu::WG_SIZE.
const WG_SIZE = 64u;
const SPLIT = 32768u;

fn group_index(workgroup: vec3<u32>) -> u32 {
    return workgroup.y * SPLIT + workgroup.x;
}

fn linear_index(workgroup: vec3<u32>, lane: u32) -> u32 {
    return group_index(workgroup) * WG_SIZE + lane;
}

// Workgroup counts for n threads, in the layout of dispatch_workgroups_indirect.
fn workgroups_for(n: u32) -> vec3<u32> {
    let groups = (n + WG_SIZE - 1u) / WG_SIZE;
    if groups <= SPLIT {
        return vec3<u32>(groups, 1u, 1u);
    }
    return vec3<u32>(SPLIT, (groups + SPLIT - 1u) / SPLIT, 1u);
}
