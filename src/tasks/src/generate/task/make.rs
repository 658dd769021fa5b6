//! Draws drafts until there are enough that pass every filter, on several threads.

use std::{collections::BTreeMap, sync::Arc};

use crate::{Stream, library::LibraryObject};
use rayon::prelude::*;
use reel_world::{Family, Scene, Task};

use super::{
    compatibility::Compatibility,
    draft::{self, DraftSpec, Source, TaskType},
    grid::GridPlacement,
    ground::{SceneSites, Site},
    placement::{self, Placement, PlacementError},
    settle,
    statistics::{Rejection, Statistics},
};

/// Gap between an object and the surface it is about to settle
/// on, in metres (docs/spec.md#real-bench).
const SPAWN_GAP_M: f64 = 0.02;

/// Options of the task generator: what to draw from, how many, and how.
#[derive(Clone, Copy, Debug)]
pub struct GenerateOptions<'a> {
    /// The scenes, in turn.
    pub scenes: &'a [Arc<Scene>],
    /// What can stand in them.
    pub library: &'a [LibraryObject],
    /// The compatibility table: which receptacles plausibly hold which objects.
    pub table: &'a Compatibility,
    /// The families, in turn.
    pub families: &'a [Family],
    /// The types, in turn within a family as [`TaskType::of_family`] has them.
    pub types: &'a [TaskType],
    /// Number of tasks to generate, over all families, types and scenes.
    pub count: usize,
    /// Seed of all choices.
    pub seed: u64,
    /// How objects are placed.
    pub placing: Placing,
    /// Threads. The tasks do not depend on it.
    pub jobs: usize,
}

/// How objects are placed on a surface. What they pass afterwards is the same.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Placing {
    /// Within reach over an edge, as the paper says.
    #[default]
    NearEdge,
    /// On the grid of REAL's generator.
    Grid,
}

/// Why nothing can be made.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum MakeError {
    /// No family has one of the types.
    #[error(
        "no selected family has tasks of the selected types; docs/tasks.md lists the types of each family"
    )]
    NothingWanted,
    /// Two scenes have one name.
    #[error("two scenes are called {scene_id}; tasks are named after their scene")]
    SameScene { scene_id: String },
    /// The worker threads cannot be started.
    #[error("{jobs} worker threads cannot be started; ask for fewer")]
    Threads {
        jobs: usize,
        source: rayon::ThreadPoolBuildError,
    },
}

/// What came of it.
#[derive(Clone, PartialEq, Debug)]
pub struct GenerateReport {
    /// The tasks, by family, scene and type, each with the index of its scene; fewer than asked for
    /// where the scenes do not allow more.
    pub tasks: Vec<(usize, Task)>,
    /// Counts of drafts, of tasks, and of rejected drafts by reason.
    pub statistics: Statistics,
}

/// Makes tasks; `on_task` is called from the threads as they come. Task ids are
/// `<family>/<scene>_<type>_<number>`, the number being that of the draft, so that
/// rejected ones leave gaps.
pub fn make(
    options: &GenerateOptions<'_>,
    on_task: impl Fn() + Sync,
) -> Result<GenerateReport, MakeError> {
    let mut names: Vec<&str> = options
        .scenes
        .iter()
        .map(|scene| scene.scene_id.as_str())
        .collect();
    names.sort_unstable();
    if let Some(twice) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        return Err(MakeError::SameScene {
            scene_id: twice[0].to_owned(),
        });
    }
    let jobs = options.jobs;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs).build();
    pool.map_err(|source| MakeError::Threads { jobs, source })?
        .install(|| make_here(options, &on_task))
}

fn make_here(
    options: &GenerateOptions<'_>,
    on_task: &(impl Fn() + Sync),
) -> Result<GenerateReport, MakeError> {
    let grounds: Vec<SceneSites> = options
        .scenes
        .par_iter()
        .map(|scene| SceneSites::survey(scene.clone()))
        .collect();
    let sources: Vec<Source<'_>> = grounds
        .par_iter()
        .map(|ground| Source {
            ground,
            library: options.library,
            triplets: ground.triplets(options.library, options.table),
        })
        .collect();
    let mut cells: Vec<Cell<'_>> = Vec::new();
    let mut turns: Vec<Vec<usize>> = Vec::new();
    for family in options.families {
        let types = TaskType::of_family(*family)
            .iter()
            .filter(|task_type| options.types.contains(task_type));
        let mut turn = Vec::new();
        for task_type in types {
            for (scene, source) in sources.iter().enumerate() {
                let same = |cell: &Cell<'_>| {
                    (cell.family, cell.task_type, cell.scene) == (*family, *task_type, scene)
                };
                let at = cells.iter().position(same).unwrap_or_else(|| {
                    cells.push(Cell::new((*family, *task_type), scene, source, options));
                    cells.len() - 1
                });
                turn.push(at);
            }
        }
        turns.push(turn);
    }
    turns.retain(|turn| !turn.is_empty());
    if turns.is_empty() {
        return Err(MakeError::NothingWanted);
    }
    // What one cell does not have is wanted of the others.
    let mut made = 0;
    let mut next = 0;
    while made < options.count && cells.iter().any(|cell| !cell.is_empty()) {
        let mut missing = options.count - made;
        while missing > 0 && cells.iter().any(|cell| !cell.is_empty()) {
            let turn = &turns[next % turns.len()];
            let cell = &mut cells[turn[next / turns.len() % turn.len()]];
            next += 1;
            if !cell.is_empty() {
                cell.wanted += 1;
                missing -= 1;
            }
        }
        cells.iter_mut().for_each(|cell| cell.fill(on_task));
        made = cells.iter().map(|cell| cell.tasks.len()).sum();
    }
    Ok(gather(options, &sources, cells))
}

fn gather(
    options: &GenerateOptions<'_>,
    sources: &[Source<'_>],
    mut cells: Vec<Cell<'_>>,
) -> GenerateReport {
    let mut statistics = Statistics {
        receptacle_pairs: sources.iter().map(|source| source.triplets.len()).sum(),
        triplets: sources
            .iter()
            .flat_map(|source| &source.triplets)
            .map(|(_, _, objects)| objects.len())
            .sum(),
        ..Statistics::default()
    };
    cells.sort_by_key(|cell| {
        (
            options
                .families
                .iter()
                .position(|family| *family == cell.family),
            cell.scene,
            cell.task_type,
        )
    });
    let mut tasks = Vec::new();
    for cell in cells {
        statistics.drafts += cell.next;
        statistics.tasks += cell.tasks.len();
        for (why, count) in cell.rejected {
            *statistics.rejected.entry(why).or_default() += count;
        }
        tasks.extend(cell.tasks.into_iter().map(|task| (cell.scene, task)));
    }
    GenerateReport { tasks, statistics }
}

/// The tasks of one family, type and scene: the drafts that pass, in the order of their numbers.
struct Cell<'a> {
    family: Family,
    task_type: TaskType,
    scene: usize,
    source: &'a Source<'a>,
    seed: u64,
    placing: Placing,
    /// The triplets in the order they are tried: every pair of receptacles once, then each again.
    order: Vec<(usize, usize, usize)>,
    /// Number of the draft that is tried next: an index into `order`.
    next: usize,
    wanted: usize,
    tasks: Vec<Task>,
    rejected: BTreeMap<Rejection, usize>,
}

impl<'a> Cell<'a> {
    fn new(
        (family, task_type): (Family, TaskType),
        scene: usize,
        source: &'a Source<'a>,
        options: &GenerateOptions<'_>,
    ) -> Self {
        let GenerateOptions { seed, placing, .. } = *options;
        let sites = &source.ground.sites;
        let scene_id = &source.ground.scene.scene_id;
        let mut stream = Stream::new(
            seed,
            &format!("triplets/{family}/{scene_id}/{}", task_type.as_str()),
            0,
        );
        let admitted = |(src, dest, _): &&(usize, usize, Vec<usize>)| {
            DraftSpec::admits(family, task_type, &sites[*src], &sites[*dest])
        };
        let pairs: Vec<&(usize, usize, Vec<usize>)> =
            source.triplets.iter().filter(admitted).collect();
        let pairs = stream.pick_some(&pairs, pairs.len());
        let objects: Vec<Vec<usize>> = pairs
            .iter()
            .map(|(_, _, objects)| stream.pick_some(objects, objects.len()))
            .collect();
        let rounds = 0..objects.iter().map(Vec::len).max().unwrap_or(0);
        let order = rounds.flat_map(|round| {
            let of_round =
                pairs
                    .iter()
                    .zip(&objects)
                    .filter_map(move |((src, dest, _), objects)| {
                        Some((*src, *dest, *objects.get(round)?))
                    });
            of_round.collect::<Vec<_>>()
        });
        let order = order.collect();
        let (next, wanted, tasks, rejected) = (0, 0, Vec::new(), BTreeMap::new());
        Self {
            family,
            task_type,
            scene,
            source,
            seed,
            placing,
            order,
            next,
            wanted,
            tasks,
            rejected,
        }
    }

    /// Whether every triplet was tried.
    fn is_empty(&self) -> bool {
        self.next == self.order.len()
    }

    /// Tries drafts until there are as many tasks as wanted, or no triplet is left. Those tried too
    /// many are forgotten, so that the counts do not depend on how many were tried at a time.
    fn fill(&mut self, on_task: &(impl Fn() + Sync)) {
        while self.tasks.len() < self.wanted && !self.is_empty() {
            let missing = self.wanted - self.tasks.len();
            let end = (self.next + missing + missing / 4)
                .max(self.next + 1)
                .min(self.order.len());
            let tried: Vec<_> = (self.next..end)
                .into_par_iter()
                .with_max_len(1)
                .map(|number| self.draft(number))
                .collect();
            for draft in tried {
                if self.tasks.len() == self.wanted {
                    break;
                }
                self.next += 1;
                match draft {
                    Ok(task) => {
                        self.tasks.push(task);
                        on_task();
                    }
                    Err(why) => *self.rejected.entry(why).or_default() += 1,
                }
            }
        }
    }

    /// One draft through all filters.
    fn draft(&self, number: usize) -> Result<Task, Rejection> {
        let Source { ground, .. } = self.source;
        let (family, kind, scene_id) =
            (self.family, self.task_type.as_str(), &ground.scene.scene_id);
        let mut stream = Stream::new(self.seed, &format!("{family}/{scene_id}/{kind}"), number);
        let (src, dest, object) = self.order[number];
        let wanted = DraftSpec {
            family,
            task_type: self.task_type,
            src,
            dest,
            object,
        };
        let name = format!("{scene_id}_{kind}_{number:05}");
        let mut task =
            draft::draw(self.source, wanted, &name, &mut stream).map_err(Rejection::Draft)?;
        place(&mut task, ground, self.placing, &mut stream).map_err(Rejection::Static)?;
        let task = Arc::new(task);
        let spawned = settle::spawn(&ground.scene, &task);
        let rests = settle::settle(&spawned).map_err(Rejection::Physics)?;
        if !settle::can_be_approached(&spawned) {
            return Err(Rejection::Approach);
        }
        drop(spawned);
        let mut task = Arc::unwrap_or_clone(task);
        for (object, rest) in task.objects.iter_mut().zip(rests) {
            object.reference_rest = Some(rest);
        }
        Ok(task)
    }
}

/// Both filters of geometry, on every receptacle that holds something at the start or, of what
/// moves, at the end.
fn place(
    task: &mut Task,
    ground: &SceneSites,
    placing: Placing,
    stream: &mut Stream,
) -> Result<(), PlacementError> {
    let in_use = |site: &&Site| {
        task.objects
            .iter()
            .any(|object| object.receptacle == site.receptacle.id)
            || site.receptacle.id == task.dest
    };
    let sites: Vec<&Site> = ground.sites.iter().filter(in_use).collect();
    let mut placement = Placement::default();
    for site in sites {
        let surface = site.surface();
        let mut grid = GridPlacement::new(surface.min, surface.max);
        let id = &site.receptacle.id;
        let mut here: Vec<usize> = (0..task.objects.len())
            .filter(|index| task.objects[*index].receptacle == *id)
            .collect();
        // The target has the choice.
        here.sort_by_key(|index| task.objects[*index].instance != task.target);
        let arriving = task.objects.iter().filter(|object| {
            object.receptacle != *id && task.goal.receptacle_of(&object.instance) == Some(id)
        });
        let sizes: Vec<[f64; 3]> = here
            .iter()
            .map(|index| task.objects[*index].size)
            .chain(arriving.map(|object| object.size))
            .collect();
        placement::static_filter(site, &sizes, stream)?;
        for index in here {
            let size = task.objects[index].size;
            let [x, y, z] = match placing {
                Placing::NearEdge => placement.place(site, size, stream)?,
                Placing::Grid => {
                    let footprint = [size[0], size[1]];
                    let best = grid.best(footprint, |at| site.free_floor_near(at));
                    // Whole micrometres, as the generator's files have them.
                    let at = best
                        .first()
                        .ok_or(PlacementError::OutOfReach)?
                        .map(|length_m| (length_m * 1e6).round() / 1e6);
                    grid.put(at, footprint);
                    [
                        at[0],
                        at[1],
                        site.receptacle.surface_height() + size[2] / 2.0,
                    ]
                }
            };
            task.objects[index].position = [x, y, ((z + SPAWN_GAP_M) * 1e4).round() / 1e4];
        }
    }
    Ok(())
}
