// exchange with sources and a level, last of three: appends the new markers. Unused slots are cleared. One thread per slot, of
// which the first also emit those of a source cell each.
// step. source_step, regions, map, cells, lattices: see source_lattice. starts: new markers in earlier cells. report: their
// number. markers: x, y, z (m), w = 1 alive, 0 deleted.
#import dispatch
#import report
#import source_lattice
#import step

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<uniform> source_step: SourceStep;
@group(0) @binding(2) var<storage, read> regions: array<Region>;
@group(0) @binding(3) var<storage, read> map: array<u32>;
@group(0) @binding(4) var<storage, read> cells: array<vec4<u32>>;
@group(0) @binding(5) var<storage, read> lattices: array<Lattice>;
@group(0) @binding(6) var<storage, read> starts: array<u32>;
@group(0) @binding(7) var<storage, read> report: array<u32>;
@group(0) @binding(8) var<storage, read_write> markers: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn emit_markers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    let n = arrayLength(&cells);
    if index >= MOST_SITES * n {
        return;
    }
    let total = report[EMITTED_NOW];
    if index >= total {
        markers[source_step.first + index] = vec4<f32>();
    }
    if index >= n {
        return;
    }
    var slot = starts[index];
    var end = total;
    if index + 1u < n {
        end = starts[index + 1u];
    }
    // Cells without new markers have candidates, too, where a body covers them.
    for (var number = 0u; number < CANDIDATES && slot < end; number++) {
        let site = candidate(cells[index], number);
        if site.emitted {
            let x = 0.5 * (vec3<f32>(site.eighth) + vec3<f32>(site.within) / f32(UNITS));
            markers[source_step.first + slot] = vec4<f32>(x * step.dx, 1.0);
            slot++;
        }
    }
}
