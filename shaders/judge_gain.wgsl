// solve, for solids, active-set search: whether phi grows from the best velocity to the next. One workgroup.
// step. partials: change of phi per node, W. answer: see ask; 1 if it grows, else 0, out.
#import ask
#import fold
#import solid_step

@group(0) @binding(0) var<uniform> step: SolidStep;
@group(0) @binding(1) var<storage, read> partials: array<Real4>;
@group(0) @binding(2) var<storage, read_write> answer: array<u32>;

@compute @workgroup_size(FOLD_SIZE)
fn judge_gain(@builtin(local_invocation_index) lane: u32) {
    let gain = fold(step.n_nodes, lane).x;
    if lane == 0u {
        answer[ANSWER] = u32(!(gain <= Real()));
    }
}
