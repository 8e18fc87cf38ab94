// PCG, one workgroup: beta = r . z / (r . z before), 0 for the refinement step's first direction. Closes the start of the refinement step.
// totals: where the number of partials stands. args, gated: see control. partials: r . z.
#import level
#import pcg_slots
#import real
#import control
#import fold

@group(0) @binding(0) var<uniform> totals: Level;
@group(0) @binding(1) var<storage, read> args: array<u32>;
@group(0) @binding(2) var<storage, read> partials: array<Real4>;
@group(0) @binding(3) var<storage, read_write> scalars: array<Real>;
@group(0) @binding(4) var<storage, read_write> control: Control;
@group(0) @binding(5) var<storage, read_write> gated: array<u32>;

@compute @workgroup_size(FOLD_SIZE)
fn pcg_beta(@builtin(local_invocation_index) lane: u32) {
    let rz = fold(args[totals.args + 3u], lane).x;
    if lane != 0u || control.running == 0u {
        return;
    }
    gate_extra(BEGIN, false);
    if !(rz > Real(0.0)) {
        // Later in a refinement step r is down to its rounding, and the evaluation judges what was reached.
        control.status = select(control.status, STATUS_BREAKDOWN, control.first == 1u);
        control.running = 0u;
        gate_lists(false);
        gate_extra(UPDATE, false);
        gate_extra(EVALUATE, true);
        return;
    }
    scalars[BETA] = select(rz / scalars[RZ], Real(0.0), control.first == 1u);
    scalars[RZ] = rz;
}
