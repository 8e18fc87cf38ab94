// advect_level with sources: fills the cells of running sources after the transport, their neighbours up to the distance to
// them. Liquid in those cells stays there, so its component before the sub-step is that of the cell. A source that starts adds the
// volume by which its cells fill.
// One thread per entry of the list; the first entry of a cell applies all.
// step. source_step: state of the sources. fills: cell (padded index), source, level (f32), index among the source cells from
// 1, or 0 or SIDE beside them, ascending. band_flags: the band, where running sources are. solid_distance: m, cell centres; one quad far
// outside in a scene without bodies. carried_level: cells, in place. first_fill: per source cell, volumes of a cell, out.
// component: before the sub-step. component_origin: in place. exchange_totals: see exchange_totals.
#import component_sums
#import dispatch
#import exchange_totals
#import filled_part
#import source_step
#import step

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<uniform> source_step: SourceStep;
@group(0) @binding(2) var<storage, read> fills: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> band_flags: array<u32>;
@group(0) @binding(4) var<storage, read> solid_distance: array<f32>;
@group(0) @binding(5) var<storage, read_write> carried_level: array<f32>;
@group(0) @binding(6) var<storage, read_write> first_fill: array<f32>;
@group(0) @binding(7) var<storage, read_write> exchange_totals: array<atomic<u32>>;
@group(0) @binding(8) var<storage, read> component: array<u32>;
@group(0) @binding(9) var<storage, read_write> component_origin: array<u32>;

// Beside a face that liquid does not leave through.
const SIDE = 0xffffffffu;

@compute @workgroup_size(WG_SIZE)
fn fill_sources(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    let n = arrayLength(&fills);
    if index >= n {
        return;
    }
    let entry = fills[index];
    let cell = entry.x;
    if index > 0u && fills[index - 1u].x == cell {
        return;
    }
    let in_band = band_flags[cell / 4u] != 0u;
    let before = carried_level[cell];
    var phi = before;
    var source_runs = false;
    for (var other = index; other < n && fills[other].x == cell; other++) {
        if in_band && runs(fills[other].y, source_step.running) {
            let level = bitcast<f32>(fills[other].z);
            phi = select(min(phi, level), level, fills[other].w == SIDE && phi > 0.0);
            source_runs |= fills[other].w != 0u && fills[other].w != SIDE;
        }
    }
    if in_band {
        carried_level[cell] = phi;
    }
    if source_runs {
        component_origin[cell] = component[cell];
    }
    if entry.w == 0u || entry.w == SIDE {
        return;
    }
    var volume = 0.0;
    if in_band && runs(entry.y, source_step.starting) {
        let distance = solid_distance[min(cell, arrayLength(&solid_distance) - 1u)];
        let added = filled_part(phi) - filled_part(before);
        volume = filled_part(-distance / step.dx) * added;
        add_total(FILLED_VOLUME, fixed(volume));
    }
    first_fill[entry.w - 1u] = volume;
}
