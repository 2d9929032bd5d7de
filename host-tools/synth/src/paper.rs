//! The tables of the paper, "SlipSense" (CoRL 2026): figures of real grippers, to stand beside ours.

use serde::Serialize;

/// A row of one of them on one split.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PaperRow {
    pub table: &'static str,
    pub method: &'static str,
    /// What it is compared with here: a detector of `slipsense eval` or a row of `slipsense reproduce`.
    pub detector: &'static str,
    /// Name of the split.
    pub input: &'static str,
    /// Median from onset to the first slip frame; means of the medians of three seeds.
    pub latency_frames: f64,
    /// "Fraction of frames incorrectly predicted as slip", percent; the paper does not say of which frames.
    pub fpr_percent: f64,
    pub accuracy_percent: f64,
    pub macro_f1_percent: f64,
    /// Whole network on the authors' RTX A4500, milliseconds; where the table of encoders has it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_ms: Option<f64>,
}

const fn entry(
    table: &'static str,
    method: &'static str,
    detector: &'static str,
    input: &'static str,
    figures: [f64; 4],
) -> PaperRow {
    let [latency_frames, fpr_percent, accuracy_percent, macro_f1_percent] = figures;
    PaperRow {
        table,
        method,
        detector,
        input,
        latency_frames,
        fpr_percent,
        accuracy_percent,
        macro_f1_percent,
        time_ms: None,
    }
}

impl PaperRow {
    const fn timed(self, ms: f64) -> Self {
        Self { time_ms: Some(ms), ..self }
    }
}

/// Tables of modalities (1) and zero-shot transfer (2), of encoders, augmentation and fusion.
pub const ROWS: [PaperRow; 27] = [
    entry("1", "Baseline Piezo", "entropy", "umi_id", [1.0, 21.69, 72.87, 74.51]),
    entry("1", "Baseline XL", "mfcc-qda", "umi_id", [1.0, 22.98, 79.41, 81.79]),
    entry("1", "Baseline AND", "entropy-and-mfcc", "umi_id", [1.0, 9.28, 81.16, 79.96]),
    entry("1", "SlipSense Piezo", "piezo", "umi_id", [20.5, 7.54, 84.63, 83.54]),
    entry("1", "SlipSense XL", "xl", "umi_id", [4.67, 2.14, 84.21, 81.61]),
    entry("1", "SlipSense", "network", "umi_id", [2.0, 1.33, 96.98, 96.77]),
    entry("1", "Baseline Piezo", "entropy", "umi_ood", [2.0, 21.08, 73.84, 75.29]),
    entry("1", "Baseline XL", "mfcc-qda", "umi_ood", [2.0, 19.31, 82.99, 84.55]),
    entry("1", "Baseline AND", "entropy-and-mfcc", "umi_ood", [2.0, 7.40, 83.33, 82.18]),
    entry("1", "SlipSense Piezo", "piezo", "umi_ood", [36.17, 8.43, 82.69, 81.91]),
    entry("1", "SlipSense XL", "xl", "umi_ood", [3.0, 3.24, 84.74, 81.33]),
    entry("1", "SlipSense", "network", "umi_ood", [1.5, 1.57, 95.99, 95.75]).timed(2.33),
    entry("2", "SlipSense", "network", "palm", [3.0, 1.99, 94.83, 94.56]),
    entry("2", "SlipSense", "network", "tesollo2", [3.0, 1.14, 95.89, 94.39]),
    entry("2", "SlipSense", "network", "tesollo3", [5.0, 3.12, 90.85, 87.24]),
    entry("encoders", "ResNet-18", "resnet18", "umi_ood", [2.0, 4.19, 93.04, 92.91]).timed(3.08),
    entry("encoders", "ViT-MAE, scratch", "vit-scratch", "umi_ood", [2.67, 2.26, 95.38, 95.33]).timed(5.31),
    entry("encoders", "ViT-MAE, freeze", "vit-frozen", "umi_ood", [2.67, 2.02, 95.75, 95.51]).timed(5.33),
    entry("encoders", "ViT-MAE, finetune", "vit-finetuned", "umi_ood", [2.0, 3.17, 95.07, 95.03]).timed(5.32),
    entry("encoders", "MLP", "paper-mlp", "umi_ood", [30.0, 4.04, 90.69, 90.38]).timed(1.07),
    entry("encoders", "1-D CNN", "paper-cnn", "umi_ood", [2.5, 2.30, 94.88, 94.68]).timed(1.33),
    entry("augmentation", "no XL augmentation", "no-xl-augmentation", "umi_ood", [1.5, 1.90, 94.80, 94.49]),
    entry("augmentation", "no XL augmentation", "no-xl-augmentation", "tesollo2", [4.0, 11.31, 89.19, 87.54]),
    entry("fusion", "late", "late", "umi_ood", [2.5, 1.65, 95.28, 95.06]),
    entry("fusion", "late", "late", "tesollo2", [4.0, 1.23, 94.86, 92.72]),
    entry("fusion", "concatenation", "concatenation", "umi_ood", [2.0, 1.65, 95.51, 95.28]),
    entry("fusion", "concatenation", "concatenation", "tesollo2", [4.5, 1.33, 95.04, 93.07]),
];

/// The first of a detector or row on a split.
pub fn row(detector: &str, input: &str) -> Option<&'static PaperRow> {
    ROWS.iter().find(|row| row.detector == detector && row.input == input)
}
