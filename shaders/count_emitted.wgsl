// exchange with sources and a level, first of three: number of new markers per source cell. Cells with their centre in a body
// receive none, nor do cells below the band of markers, where marker_band would delete them. One thread per source cell.
// level, step. source_step, regions, map, cells, lattices: see source_lattice. solid_distance: m, cell centres; one quad, far
// outside, in a scene without solids. liquid_distance: before the sub-step, m. counts: per source cell; out.
#import dispatch
#import layout
#import marker_depth
#import source_lattice
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<uniform> source_step: SourceStep;
@group(0) @binding(3) var<storage, read> regions: array<Region>;
@group(0) @binding(4) var<storage, read> map: array<u32>;
@group(0) @binding(5) var<storage, read> cells: array<vec4<u32>>;
@group(0) @binding(6) var<storage, read> lattices: array<Lattice>;
@group(0) @binding(7) var<storage, read> solid_distance: array<f32>;
@group(0) @binding(8) var<storage, read> liquid_distance: array<f32>;
@group(0) @binding(9) var<storage, read_write> counts: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn count_emitted(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= arrayLength(&cells) {
        return;
    }
    let cell = cells[index];
    let at = cell_index(level, cell.xyz);
    let covered = solid_distance[min(at, arrayLength(&solid_distance) - 1u)] < 0.0;
    let deep = liquid_distance[at] < -MARKER_DEPTH * step.dx;
    var n = 0u;
    if runs(source_of(cell.w), source_step.running) && !covered && !deep {
        for (var number = 0u; number < CANDIDATES; number++) {
            n += u32(candidate(cell, number).emitted);
        }
    }
    counts[index] = n;
}
