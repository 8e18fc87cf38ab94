// diagnose with solids in liquid, last: writes the sum of a force over the nodes to the report. One workgroup.
// coupling. first: word of the report, in x. partials: forces of the nodes, N. report: see fields::CouplingReport.
#import coupling
#import fold
#import report_sum

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<uniform> first: vec4<u32>;
@group(0) @binding(2) var<storage, read> partials: array<Real4>;
@group(0) @binding(3) var<storage, read_write> report: array<u32>;

@compute @workgroup_size(FOLD_SIZE)
fn report_coupling(@builtin(local_invocation_index) lane: u32) {
    let sum = fold(coupling.n_nodes, lane);
    if lane == 0u {
        for (var axis = 0u; axis < 3u; axis++) {
            report_sum(first.x + 2u * axis, sum[axis]);
        }
    }
}
