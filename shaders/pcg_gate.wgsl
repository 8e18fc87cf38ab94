// PCG, one thread, before a block of iterations: whether the one-workgroup kernels of the block run. They write gated, so their own
// dispatch size must stand elsewhere. They also close the update after a refinement step's last iteration, which is left to do here when
// that was the last of its block.
// control: the state. args, gated: see control. gate: workgroups x, y, z and a spare word, for one workgroup and for the first
// level of long sums.
#import control

// Must be solver::FOLD_THREADS / gpu::WG_SIZE.
const FOLD_GROUPS = 64u;

@group(0) @binding(0) var<storage, read> control: Control;
@group(0) @binding(1) var<storage, read> args: array<u32>;
@group(0) @binding(2) var<storage, read_write> gated: array<u32>;
@group(0) @binding(3) var<storage, read_write> gate: array<u32>;

@compute @workgroup_size(1)
fn pcg_gate() {
    if control.running == 0u {
        gate_extra(UPDATE, false);
    }
    gate[0] = control.running;
    gate[1] = 1u;
    gate[2] = 1u;
    gate[4] = FOLD_GROUPS * control.running;
    gate[5] = 1u;
    gate[6] = 1u;
}
