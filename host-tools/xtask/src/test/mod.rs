//! `cargo xtask test`: what must hold, as a list of steps.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::path::Path;
use std::process::Command;
use std::sync::{Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, ensure};
use clap::Args;

use crate::process::{empty_dir, root};

mod steps;

use steps::{Context, DAILY, STEPS, Size, Step};

/// Which steps to run.
#[derive(Args, Clone, Debug)]
#[command(after_help = "\
`cargo xtask test` runs the steps for the daily loop, `cargo xtask test all` all of them and what takes
longer of the host's: trainer, Python and ROS 2 packages, tests that generate hours of data.
Two steps run at a time, all of them also after one has failed. What a step needs and is missing is installed where
that is possible (rustup target, Debian packages as root, Python packages into target/venv); where it is not, the
step fails and says what to install. Nothing is skipped silently.

Commands of their own, because they take long or need a network: cargo xtask linux, cargo xtask ros2,
cargo xtask twin --long, cargo xtask twin --updates.

Environment: SLIPSENSE_TOOLCHAIN=debian builds for the Cortex-M7 with Debian's compiler.

Examples:
  cargo xtask test --only fmt --only programs --only host
  cargo xtask test all --list")]
pub struct Options {
    /// Run all steps, with the trainer
    #[arg(value_enum)]
    size: Option<Size>,
    /// Only these steps, one after the other; may be given several times
    #[arg(long, value_name = "STEP")]
    only: Vec<String>,
    /// What the steps run is built already
    #[arg(long, hide = true)]
    built: bool,
    /// Print the steps and stop
    #[arg(long)]
    list: bool,
}

/// Steps at a time: emulators run on one core, beside a compiler.
const WORKERS: usize = 2;

/// Run the steps; `false` if one failed.
pub fn run(options: &Options) -> Result<bool> {
    let size = options.size.unwrap_or(Size::Daily);
    let named = |name: &String| {
        STEPS.iter().find(|step| step.name == *name).with_context(|| {
            let names: Vec<_> = STEPS.iter().map(|step| step.name).collect();
            format!("no step is called `{name}`; there are: {}", names.join(", "))
        })
    };
    let mut steps: Vec<&Step> = options.only.iter().map(named).collect::<Result<_>>()?;
    if options.only.is_empty() {
        steps.extend(STEPS.iter().filter(|step| size == Size::All || DAILY.contains(&step.name)));
    }
    if options.list {
        steps.iter().for_each(|step| println!("{:<15} {}", step.name, step.what));
        return Ok(true);
    }
    if !options.only.is_empty() {
        for step in steps {
            // What the daily loop lacks may need what only the whole run builds.
            let size = if DAILY.contains(&step.name) { size } else { Size::All };
            let context = Context { size, is_built: options.built };
            (step.run)(context).with_context(|| format!("step {}", step.name))?;
        }
        return Ok(true);
    }
    let started = Instant::now();
    let logs = empty_dir("test-logs")?;
    // A step may build this program anew.
    let copies = tempfile::tempdir()?;
    let program = copies.path().join("xtask");
    fs::copy(std::env::current_exe()?, &program).context("cannot copy this program")?;
    let schedule = Schedule::new(&steps);
    std::thread::scope(|scope| {
        for _ in 0..WORKERS {
            scope.spawn(|| schedule.work(&|step| one(&program, &logs, step, size)));
        }
    });
    let done = schedule.state.into_inner().expect("no worker panics").done;
    println!();
    for (name, time, passed) in &done {
        println!("{:<6} {:>8}  {name}", if *passed { "passed" } else { "FAILED" }, seconds(*time));
    }
    let failed = done.iter().filter(|(.., passed)| !passed).count();
    println!("{} passed, {failed} failed, {} in all", done.len() - failed, seconds(started.elapsed()));
    ensure!(done.len() == steps.len(), "{} of {} steps ran", done.len(), steps.len());
    Ok(failed == 0)
}

/// One step as a process of its own, whose output is printed when it has ended.
fn one(program: &Path, logs: &Path, step: &Step, size: Size) -> Result<()> {
    let path = logs.join(step.name);
    let log = File::create(&path).with_context(|| path.display().to_string())?;
    let mut child = Command::new(program);
    child.current_dir(root()).arg("test").args((size == Size::All).then_some("all"));
    let status = child.args(["--built", "--only", step.name]).stdout(log.try_clone()?).stderr(log).status();
    let text = fs::read(&path).with_context(|| path.display().to_string())?;
    eprint!("\n---- {}: {}\n{}", step.name, step.what, String::from_utf8_lossy(&text));
    let status = status.context("cannot start the step")?;
    ensure!(status.success(), "{status}");
    Ok(())
}

struct Schedule<'s> {
    state: Mutex<State<'s>>,
    changed: Condvar,
}

struct State<'s> {
    waiting: Vec<&'s Step>,
    running: BTreeSet<&'static str>,
    /// Name, time, and whether it passed.
    done: Vec<(&'static str, Duration, bool)>,
}

impl<'s> Schedule<'s> {
    fn new(steps: &[&'s Step]) -> Self {
        let state = State { waiting: steps.to_vec(), running: BTreeSet::new(), done: Vec::new() };
        Self { state: Mutex::new(state), changed: Condvar::new() }
    }

    fn state(&self) -> MutexGuard<'_, State<'s>> {
        self.state.lock().expect("no worker panics")
    }

    /// Run steps until none is left: the first one that may start, each time.
    fn work(&self, run: &dyn Fn(&Step) -> Result<()>) {
        let mut state = self.state();
        while !state.waiting.is_empty() {
            let Some(next) = state.waiting.iter().position(|step| state.may_start(step)) else {
                state = self.changed.wait(state).expect("no worker panics");
                continue;
            };
            let step = state.waiting.remove(next);
            state.running.insert(step.name);
            drop(state);
            let start = Instant::now();
            let result = run(step);
            let time = start.elapsed();
            match &result {
                Ok(()) => eprintln!("---- {}: passed in {}", step.name, seconds(time)),
                Err(error) => eprintln!("---- {}: FAILED in {}: {error:#}", step.name, seconds(time)),
            }
            state = self.state();
            state.running.remove(step.name);
            state.done.push((step.name, time, result.is_ok()));
            self.changed.notify_all();
        }
    }
}

impl State<'_> {
    /// A step that compiles uses every core, so no other one compiles beside it; a step that runs programs waits for
    /// those that build them.
    fn may_start(&self, step: &Step) -> bool {
        let is_open = |name: &str| {
            self.running.contains(name) || self.waiting.iter().any(|waiting| waiting.name == name)
        };
        let compiles = |name: &str| STEPS.iter().any(|step| step.name == name && step.compiles);
        let is_held_up = step.compiles && self.running.iter().any(|name| compiles(name));
        !is_held_up && !step.after.iter().any(|name| is_open(name))
    }
}

fn seconds(time: Duration) -> String {
    format!("{:.1} s", time.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_step_runs_once_after_those_it_waits_for() {
        let steps: Vec<&Step> = STEPS.iter().collect();
        let schedule = Schedule::new(&steps);
        std::thread::scope(|scope| {
            (0..WORKERS).for_each(|_| _ = scope.spawn(|| schedule.work(&|_| Ok(()))));
        });
        let done = schedule.state.into_inner().unwrap().done;
        assert_eq!(done.len(), STEPS.len());
        let place = |name: &str| done.iter().position(|(done, ..)| *done == name).unwrap();
        for step in STEPS {
            for before in step.after {
                assert!(place(before) < place(step.name), "{} before {}", step.name, before);
            }
        }
    }
}
