"""Plans: what is refused, and what a plan becomes."""

import shutil
from pathlib import Path

import pytest

import deepmf_sumo
from deepmf_sumo.errors import SpecError, UsageError
from deepmf_sumo.study import plans
from deepmf_sumo.study.plans import entries
from deepmf_sumo.study.plans import plan as plan_module
from deepmf_sumo.study.plans.layout import layout_of
from deepmf_sumo.study.plans.run import _scene_by_scene

from tests.support import tiny_plan

BUDGETS = """
equal_seconds: {seconds: 2.0, methods: [fixed], scenes: {first: 1}}
curves:
  planners: [lane]
  methods: {fixed: {simulations: [3, 9], seconds: [2.0]}}
"""


@pytest.fixture
def plan(tiny):
    def load(text=tiny_plan.PLAN, sets=(), without=()):
        return plans.load(tiny_plan.write(tiny, text), sets, without)

    return load


def rows_of(loaded, folder):
    rows = entries.entries_of(loaded, folder)
    return rows, entries.tasks_of(rows, loaded.plan.seeds)


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (["methods={}"], "key 'methods': the plan has no methods; name at least one"),
        (["planners={}"], "key 'planners': the plan has no planners"),
        (["seeds=[]"], "key 'seeds'"),
        (["source=[]"], "key 'source'"),
        (["name=1"], "key 'name': 1: .*put it in quotes"),
        (["method=1"], "key 'method': unknown key. Did you mean 'methods'"),
        (["methods.none={budget: {}}"], "key 'methods.none.adversary'"),
        (["methods.fixed.budget.seconds=0"], "key 'methods.fixed.budget.seconds': 0"),
        (["methods.fixed.budget.simulations=1e2"], "numbers without quotes"),
        (["methods.fixed.planners=[lan]"], "'lan' is none of the plan's. Did you mean 'lane'"),
        (["tables.baseline=fix"], r"key 'tables.baseline': 'fix' is none.* Did you mean 'fixed'"),
        (["methods.FIXED=none"], "would have the folder name 'fixed'"),
        (["curves={methods: {bga: {}}}"], "key 'curves.methods': 'bga' is none of the plan's"),
        (["equal_seconds={seconds: 1.0, methods: []}"], "key 'equal_seconds.methods'"),
        (["curves={methods: {fixed: {}}, scenes: {first: 0}}"], "key 'curves.scenes.first': 0"),
        (["source.network=nowhere.sumocfg"], "'source' holds no keys"),
    ],
)
def test_wrong_plans(plan, sets, message):
    with pytest.raises(SpecError, match=message):
        plan(sets=sets)


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (["methods.none=nobody"], "No plug-in 'nobody' in adversaries.*method 'nobody|none'"),
        (["planners.straight=constant_velocty"], "Did you mean 'constant_velocity'"),
        (["planners.lane.perception=eyes"], "key 'planner.perception': 'eyes'"),
        (["methods.fixed.adversary.agnt=x"], "unknown key. Did you mean 'agent'"),
        (["traffic=log"], "log is for recordings"),
        (["weights=no/such"], "no such file or folder"),
    ],
)
def test_wrong_settings_name_file_line_and_method(plan, tmp_path, sets, message):
    with pytest.raises(SpecError, match=message) as found:
        entries.entries_of(plan(sets=sets), tmp_path)
    assert "on planner" in str(found.value)


def test_a_wrong_line_is_named(plan, tmp_path):
    text = tiny_plan.PLAN.replace("agent: leader", "agnt: leader")
    with pytest.raises(SpecError, match=r"plan.yaml:10: key 'adversary.agent': Field required"):
        entries.entries_of(plan(text), tmp_path)


def test_a_method_that_is_not_installed_says_how_to_install_or_leave_it_out(plan, tmp_path):
    text = tiny_plan.PLAN.replace("leader, poses", "leader, file: nowhere.csv, poses")
    text = text.replace(f", poses: [{tiny_plan.POSES}]", "")
    with pytest.raises(SpecError, match=r"method 'fixed': .*Or leave it out: --without fixed"):
        entries.entries_of(plan(text), tmp_path)


def test_a_set_without_the_network_that_strive_needs_is_found_out_before(plan, tmp_path):
    packed = Path(deepmf_sumo.__file__).parent / "weights" / "open"
    for file in packed.iterdir():
        if file.is_file() and not file.name.startswith("strive"):
            shutil.copy(file, tmp_path)
    both = plan(sets=["methods.STRIVE=strive", f"weights={tmp_path}"])
    with pytest.raises(SpecError, match=r"'STRIVE': .*strive.json.*--without STRIVE"):
        entries.entries_of(both, tmp_path)
    entries.entries_of(plan(sets=["methods.STRIVE=strive", f"weights={packed}"]), tmp_path)


def test_tasks_are_in_the_order_of_the_tables(plan, tmp_path):
    _, tasks = rows_of(plan(sets=["seeds=[3, 4]"]), tmp_path)
    assert len(tasks) == 2 * 2 * 2 * 2
    assert [task.run_id for task in tasks[:4]] == [
        "none-on-lane--tiny-2-s-av--3",
        "none-on-lane--tiny-2-s-av--4",
        "none-on-lane--tiny-3-s-av--3",
        "none-on-lane--tiny-3-s-av--4",
    ]
    assert tasks[0].entropy() != tasks[1].entropy() != tasks[2].entropy()
    assert tasks[0].entropy() == tasks[-4].entropy(), "dice differ between methods"
    assert len({task.key for task in tasks}) == len(tasks)


def test_runs_begin_scene_by_scene(plan, tmp_path):
    loaded = plan(tiny_plan.PLAN + BUDGETS)
    rows, tasks = rows_of(loaded, tmp_path)
    order = sorted(tasks, key=_scene_by_scene(rows, loaded.plan.seeds))
    assert [task.label.part for task in order] == ["main"] * 8 + ["budgets"] * 7
    assert len({task.scene for task in order[:4]}) == 1
    assert {task.label.method for task in order[:2]} == {"none", "fixed"}


def test_budgets_are_methods_of_their_own_and_run_once(plan, tmp_path):
    loaded = plan(tiny_plan.PLAN + BUDGETS)
    rows, tasks = rows_of(loaded, tmp_path)
    others = [task for task in tasks if task.label.part == "budgets"]
    assert {task.label.method for task in others} == {
        "fixed (2 s)", "fixed (3 simulations)", "fixed (9 simulations)",
    }  # fmt: skip
    assert {task.label.base for task in others} == {"fixed"}
    assert len(others) == len({task.run_id for task in others}) == 7
    assert all(task.spec.budget.seconds == 2.0 for task in others if "(2 s)" in task.label.method)
    layout = layout_of(loaded.plan, rows, tasks)
    assert layout.equal_seconds.scenes == ["tiny 2 s av"]
    assert layout.curves.planners == ["lane"]
    assert len(layout.curves.budgets["fixed"]) == 3


def test_a_budget_that_is_the_methods_own_is_not_run_again(plan, tmp_path):
    loaded = plan(tiny_plan.PLAN + BUDGETS, ["methods.fixed.budget={simulations: 9}"])
    _, tasks = rows_of(loaded, tmp_path)
    assert not any("9 simulations" in task.label.method for task in tasks)


def test_a_method_called_as_one_with_a_budget_is_refused(plan, tmp_path):
    loaded = plan(tiny_plan.PLAN + BUDGETS, ["methods.fixed (2 s)=none"])
    with pytest.raises(SpecError, match="give it another name"):
        rows_of(loaded, tmp_path)


def test_methods_for_figures_alone_are_in_no_table(plan, tmp_path):
    loaded = plan(
        sets=["methods.none={adversary: none, figures_only: true, planners: [lane]}",
              "methods.none.scenes={first: 1}", "tables.compared=[fixed]"]
    )  # fmt: skip
    rows, tasks = rows_of(loaded, tmp_path)
    assert [task.label.part for task in tasks].count("figures") == 1
    layout = layout_of(loaded.plan, rows, tasks)
    assert layout.methods == ["fixed"]
    assert layout.planned("none", "lane") == 1
    assert layout.planned("none", "straight") == 0


def test_left_out_methods_are_nowhere(plan, tmp_path):
    loaded = plan(tiny_plan.PLAN, without=["none"])
    assert list(loaded.plan.methods) == ["fixed"]
    assert loaded.plan.tables.compared == ("fixed",)
    with pytest.raises(SpecError, match=r"--without nome: .*Did you mean 'none'"):
        plan(without=["nome"])


def test_the_same_situation_twice_is_refused(plan, tmp_path):
    with pytest.raises(SpecError, match="'tiny 2 s av' is given twice"):
        entries.entries_of(plan(tiny_plan.PLAN.replace("start_s: 3.0", "start_s: 2.0")), tmp_path)


@pytest.mark.parametrize("of", [1, 2, 3, 8])
def test_shards_make_up_the_plan_and_have_every_method(plan, tmp_path, of):
    _, tasks = rows_of(plan(), tmp_path)
    shards = [plans.Shard(number=number + 1, of=of).choose(tasks) for number in range(of)]
    together = [task.run_id for shard in shards for task in shard]
    assert sorted(together) == sorted(task.run_id for task in tasks)
    assert len(together) == len(set(together))
    if of == 2:
        assert {task.label.method for task in shards[0]} == {"none", "fixed"}


@pytest.mark.parametrize("text", ["0/2", "3/2", "1", "a/b", "1/0", "-1/2", "1/2/3"])
def test_bad_shards(text):
    with pytest.raises(UsageError, match="--shard"):
        plans.Shard.parse(text)


def test_the_papers_plan_is_found_in_a_checkout_and_in_a_package(tmp_path, monkeypatch):
    assert plan_module.packaged().name == "paper.yaml"
    module = tmp_path / "deepmf_sumo" / "__init__.py"
    (module.parent / "starter").mkdir(parents=True)
    monkeypatch.setattr(plan_module.deepmf_sumo, "__file__", str(module))
    with pytest.raises(UsageError, match=r"lacks paper\.yaml"):
        plan_module.packaged()
    (module.parent / "starter" / "paper.yaml").write_text("")
    assert plan_module.packaged() == module.parent / "starter" / "paper.yaml"


def test_the_papers_plan_can_be_read(monkeypatch, tmp_path):
    from deepmf_sumo.scene import readers
    from deepmf_sumo.spec import tasks as batch_tasks

    found = [
        readers.RecordRef(file=tmp_path, name=name, record=number)
        for number, name in enumerate("ab")
    ]
    monkeypatch.setattr(readers, "records", lambda path, cache: iter(found))
    assert batch_tasks.readers is readers
    assert plans.is_plan(Path("paper"))
    loaded = plans.load(Path("paper"), [f'source.recording="{tmp_path}"'])
    rows, planned = rows_of(loaded, tmp_path)
    layout = layout_of(loaded.plan, rows, planned)
    assert layout.baseline == "DeepMF-S1"
    versions = ["G", "S4", "S2", "S1"]
    published = [f"DeepMF (paper) {one}" for one in versions]
    assert layout.versions == [*published, *(f"DeepMF-{one}" for one in versions)]
    assert layout.methods[:4] == published
    assert {row.specs[0].adversary.settings.get("form") for row in rows[:4]} == {"paper"}
    assert layout.compared[0] == "DeepMF (paper) S1"
    assert set(layout.compared) >= {"STRIVE", "ART", "BBO", "BRS", "BGA", "DeepMF-S1"}
    asked = {
        row.specs[0].adversary.settings.get("sector") for row in rows if row.label.part == "figures"
    }
    assert len(asked) == 8


def test_a_folder_does_not_stand_for_the_papers_plan(tmp_path, monkeypatch):
    """`run paper --out paper` is done twice; a file of this name is the user's."""
    monkeypatch.chdir(tmp_path)
    Path("paper").mkdir()
    assert plans.is_plan(Path("paper"))
    assert plans.load(Path("paper"), [f'source.recording="{tmp_path}"']).plan.methods
    Path("paper").rmdir()
    Path("paper").write_text("version: 2\nname: mine\n")
    assert not plans.is_plan(Path("paper"))
