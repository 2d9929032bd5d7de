//! `slipsense train`, `mine`, `quantize`, `reproduce` and `leave-out`: part of a build with the feature `train`, which
//! compiles tensor libraries; any other build says how to get them.

#[cfg(feature = "train")]
use anyhow::Context;
#[cfg(feature = "train")]
pub use slipsense_model::{
    LeaveOutArgs, MineArgs, QuantizeArgs, ReproduceArgs, TrainArgs, run_leave_out as leave_out,
    run_mine as mine, run_train as train,
};

#[cfg(not(feature = "train"))]
pub use without::{
    NotInBuild as LeaveOutArgs, NotInBuild as MineArgs, NotInBuild as QuantizeArgs,
    NotInBuild as ReproduceArgs, NotInBuild as TrainArgs, *,
};

/// Run the paper's comparisons; with all rows, show what the shipped network does as well.
#[cfg(feature = "train")]
pub fn reproduce(args: &ReproduceArgs) -> anyhow::Result<()> {
    slipsense_model::run_reproduce(args)?;
    if args.rows.is_empty() {
        let text = super::shipped::report(&args.out.join("shipped"))?;
        let path = args.out.join(slipsense_model::REPORT_FILE);
        let rows = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        crate::output::write_file(&path, format!("{rows}\n{text}"))?;
        if !args.json {
            super::print(&text)?;
        }
    }
    Ok(())
}

/// Turn a trained network into a model file.
#[cfg(feature = "train")]
pub fn quantize(args: &QuantizeArgs) -> anyhow::Result<()> {
    // It works for minutes before it writes.
    for path in [Some(&args.out), args.report.as_ref()].into_iter().flatten() {
        crate::output::check_file(path)?;
    }
    slipsense_model::run_quantize(args)
}

#[cfg(not(feature = "train"))]
mod without {
    use anyhow::Result;

    pub use crate::commands::NotInBuild;

    pub fn train(args: &NotInBuild) -> Result<()> {
        args.refuse("train")
    }

    pub fn mine(args: &NotInBuild) -> Result<()> {
        args.refuse("mine")
    }

    pub fn quantize(args: &NotInBuild) -> Result<()> {
        args.refuse("quantize")
    }

    pub fn reproduce(args: &NotInBuild) -> Result<()> {
        args.refuse("reproduce")
    }

    pub fn leave_out(args: &NotInBuild) -> Result<()> {
        args.refuse("leave-out")
    }
}
