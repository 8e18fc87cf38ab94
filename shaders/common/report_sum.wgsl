// Writes a sum to the report: an f32 and its remainder. The importing kernel declares report: array<u32>.
#import real

fn report_sum(word: u32, sum: Real) {
    let high = f32(sum);
    report[word] = bitcast<u32>(high);
    report[word + 1u] = bitcast<u32>(f32(sum - Real(high)));
}
