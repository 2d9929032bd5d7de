//! Rows at once, one on each core: networks this small keep one core busy, not two.

use std::collections::VecDeque;
use std::sync::Mutex;

use anyhow::{Result, anyhow};

use super::Row;

/// How many run at once where nobody says so: one on each core.
pub(super) fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// A row to train and score, and the seed of its first weights and draws.
pub(super) type Job = (&'static Row, u64);

/// Each row with those that need its weights behind it; first the rows with the paper's encoders, which take longest.
pub(super) fn chains(missing: &[Job]) -> VecDeque<Vec<Job>> {
    let needs = |&(row, seed): &Job, other: &Job| row.needs() == Some(other.0.name) && seed == other.1;
    let is_first = |job: &&Job| !missing.iter().any(|other| needs(job, other));
    let mut chains: Vec<Vec<Job>> = Vec::new();
    for first in missing.iter().filter(is_first) {
        let behind = missing.iter().filter(|job| needs(job, first));
        chains.push(std::iter::once(first).chain(behind).copied().collect());
    }
    chains.sort_by_key(|chain| chain[0].0.encoders.is_none());
    chains.into()
}

/// Run all chains, `at_once` at a time, each on one thread. After an error the others finish the row they are at.
pub(super) fn run<J: Send, T: Send>(
    chains: VecDeque<Vec<J>>,
    at_once: usize,
    run_job: impl Fn(J) -> Result<T> + Sync,
) -> Result<Vec<T>> {
    let waiting = Mutex::new(chains);
    let next = || waiting.lock().expect("no worker panics with the lock").pop_front();
    let stop = || waiting.lock().expect("no worker panics with the lock").clear();
    let work = || {
        let mut results = Vec::new();
        while let Some(chain) = next() {
            for job in chain {
                results.push(run_job(job).inspect_err(|_| stop())?);
            }
        }
        anyhow::Ok(results)
    };
    let on_one_thread = || rayon::ThreadPoolBuilder::new().num_threads(1).build()?.install(work);
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..at_once).map(|_| scope.spawn(on_one_thread)).collect();
        let results = workers.into_iter().map(|worker| {
            worker.join().map_err(|_| anyhow!("a row panicked, as said above")).and_then(|result| result)
        });
        results.collect::<Result<Vec<_>>>().map(|results| results.into_iter().flatten().collect())
    })
}

#[cfg(test)]
mod tests {
    use anyhow::bail;

    use super::*;
    use crate::variants::row_named;

    fn jobs(names: &[&str], seeds: &[u64]) -> Vec<Job> {
        let row = |name: &&str| row_named(name).expect("a row");
        names.iter().flat_map(|name| seeds.iter().map(move |&seed| (row(name), seed))).collect()
    }

    #[test]
    fn every_row_runs_once_and_behind_what_it_needs() {
        let missing = jobs(&["base", "xl", "wide", "distilled", "integers", "paper"], &[1, 2]);
        let chains = chains(&missing);
        assert_eq!(chains[0][0].0.name, "paper");
        let done = Mutex::new(Vec::new());
        let ran = run(chains, 2, |(row, seed)| {
            let mut done = done.lock().unwrap();
            assert!(row.needs().is_none_or(|needed| done.contains(&(needed, seed))));
            done.push((row.name, seed));
            Ok(())
        });
        assert_eq!(ran.unwrap().len(), missing.len());
        let done = done.into_inner().unwrap();
        assert!(missing.iter().all(|(row, seed)| done.contains(&(row.name, *seed))));
    }

    #[test]
    fn what_needs_weights_of_an_earlier_run_stands_alone() {
        assert_eq!(chains(&jobs(&["distilled", "integers"], &[1])).len(), 2);
    }

    #[test]
    fn an_error_ends_the_queue() {
        let ran = Mutex::new(0);
        let run = run(chains(&jobs(&["xl", "piezo", "late", "t6"], &[1])), 1, |(row, _)| {
            *ran.lock().unwrap() += 1;
            if row.name == "piezo" { bail!("no space") } else { Ok(()) }
        });
        assert!(format!("{:#}", run.unwrap_err()).ends_with("no space"));
        assert_eq!(ran.into_inner().unwrap(), 2);
    }
}
