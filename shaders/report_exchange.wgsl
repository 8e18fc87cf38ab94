// liquid_components with an exchange, last: reports the numbers of markers and the volumes of this sub-step. One thread.
// marker_counts: see marker_counts. exchange_totals: see exchange_totals. component_totals: see sum_components. report: see report.
#import marker_counts
#import report

@group(0) @binding(0) var<storage, read> marker_counts: array<u32>;
@group(0) @binding(1) var<storage, read> exchange_totals: array<u32>;
@group(0) @binding(2) var<storage, read> component_totals: array<u32>;
@group(0) @binding(3) var<storage, read_write> report: array<u32>;

@compute @workgroup_size(1)
fn report_exchange() {
    report[LEFT_NOW] = report[LEAVING];
    report[SUNK_NOW] = report[SINKING];
    report[LEAVING] = 0u;
    report[SINKING] = 0u;
    report[LEFT_SPRAY_NOW] = marker_counts[LEFT_SPRAY];
    report[SUNK_SPRAY_NOW] = marker_counts[SUNK_SPRAY];
    for (var word = 0u; word < 8u; word++) {
        report[EXCHANGED_NOW + word] = exchange_totals[word];
    }
    report[LIQUID_NOW] = component_totals[0];
    report[LIQUID_NOW + 1u] = component_totals[1];
}
