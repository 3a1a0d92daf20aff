"""Operations counted in the compiled code: exact on kernels whose number is known, and near the sources' on real ones."""

import re

import numpy as np
import pytest

from pipeline import domain
from pipeline.bounds import BOUNDS
from tiler import compiled_costs, costs
from tiler.compiled_costs import (
    Recorder,
    compile_counted,
    count_compiled,
    cut_blocks,
    instrument,
    operations_of,
    own_functions,
)

compiled = pytest.mark.skipif(
    not compiled_costs.available(),
    reason="nothing is compiled: NUMBA_DISABLE_JIT is set, and there is no code to count in",
)

LINES = {
    "  %a = fadd double %b, %c": ("add", 1),
    "  %a = fsub <8 x double> %b, %c": ("sub", 8),
    "  %.12 = fmul nnan contract <16 x float> %b, %c, !dbg !3": ("mul", 16),
    "  %a = fdiv float %b, 0x3FF0000000000000": ("div", 1),
    "  %a = fcmp olt <4 x float> %b, %c": ("compare", 4),
    "  %a = fcmp nsz uno double %b, 0.000000e+00": ("compare", 1),
    "  %a = tail call double @llvm.sqrt.f64(double %b)": ("sqrt", 1),
    "  %a = call <8 x double> @llvm.sqrt.v8f64(<8 x double> %b)": ("sqrt", 8),
    "  %a = tail call <16 x float> @llvm.floor.v16f32(<16 x float> %b)": ("round", 16),
    "  %a = call float @llvm.maxnum.f32(float %b, float %c)": ("compare", 1),
    "  %a = call <4 x double> @llvm.fmuladd.v4f64(<4 x double> %b, <4 x double> %c, <4 x double> %d)": ("mul", 8),
    "  %a = call double @llvm.vector.reduce.fmax.v8f64(<8 x double> %b)": ("compare", 7),
    "  %a = call double @llvm.vector.reduce.fadd.v8f64(double 0.0, <8 x double> %b)": ("add", 8),
    "  %a = tail call double @sqrt(double %b) #3": ("sqrt", 1),
    "  %a = call nnan float @floorf(float %b)": ("round", 1),
    "  %a = call double @cos(double %b)": ("", 0),
    "  %a = fneg double %b": ("", 0),
    "  %a = call double @llvm.fabs.f64(double %b)": ("", 0),
    "  %a = add i64 %b, %c": ("", 0),
    "  %a = fptrunc double %b to float": ("", 0),
    "  %a = load <8 x double>, ptr %fmul, align 8": ("", 0),
    "  call void @NRT_decref(ptr %a)": ("", 0),
    "  %a = select i1 %b, double %c, double %d": ("", 0),
}


@pytest.mark.parametrize("line", LINES)
def test_float_operations_of_a_line(line):
    assert operations_of(line) == LINES[line]


IR = """
define linkonce_odr i32 @f(double %x, i64 %n) local_unnamed_addr {
entry:
  %y = fadd double %x, %x
  br label %loop

loop:                                             ; preds = %loop, %entry
  %i = phi i64 [ 0, %entry ], [ %j, %loop ]
  %s = phi double [ %y, %entry ], [ %t, %loop ]
  %j = add i64 %i, 1
  %t = fmul double %s, %x
  %u = fmul double %t, %x
  %c = icmp eq i64 %j, %n
  br i1 %c, label %end, label %loop

end:
  %r = call i32 @g.1(ptr @f)
  ret i32 0
}

declare double @llvm.sqrt.f64(double)
"""


def test_shared_functions_become_the_modules_own():
    text = own_functions(IR, ".counted7")
    assert "define internal i32 @f.counted7(double %x" in text and "call i32 @g.1(ptr @f.counted7)" in text
    assert text.replace(".counted7", "").replace("internal", "linkonce_odr") == IR, "and nothing else is changed"


def test_counters_stand_behind_phis():
    blocks = cut_blocks(IR)
    assert blocks.operations == [{"add": 1}, {"mul": 2}, {}]
    text = instrument(blocks, 4096)
    assert [int(a) for a in re.findall(r"load i64, ptr inttoptr \(i64 (\d+) to ptr\)", text)] == [4096, 4104, 4112]
    assert text.index("%s = phi") < text.index("%counter.1.before") < text.index("%j = add")
    without = re.sub(r"^  (?:%counter\.|store i64 %counter\.).*\n", "", text, flags=re.MULTILINE)
    assert without.split() == IR.split(), "and nothing else is changed"


def horner(x, n):
    y = 0.0
    for _ in range(n):
        y = y * x + 1.0
    return y


def multiply_add(a, b, out):
    for i in range(len(out)):
        out[i] = a[i] * b[i] + np.float32(0.5)


def newton(x):
    """Steps until the root no longer falls."""
    y, steps = x, 0
    while True:
        z = 0.5 * (y + x / y)
        steps += 1
        if not z < y:
            return steps
        y = z


def sum_of_roots(a):
    total = 0.0
    for i in range(len(a)):
        total += np.sqrt(a[i])
    return total


@compiled
@pytest.mark.parametrize("n", [0, 1, 7, 1000])
def test_a_chain_is_counted_exactly(n):
    counted = compile_counted(horner, (0.5, n))
    assert counted.run(0.5, n) == horner(0.5, n)
    assert counted.take() == {kind: n for kind in ("add", "mul") if n}
    assert counted.take() == {}, "and taken once"


@compiled
@pytest.mark.parametrize("n", [5, 16, 1000, 1003])
def test_vectors_are_counted_by_their_lanes(n):
    a, b, out = (np.arange(n, dtype=np.float32) + k for k in range(3))
    counted = compile_counted(multiply_add, (a, b, out))
    assert any(amount >= 4 for block in counted.operations for amount in block.values()), "the loop is vectorized"
    counted.run(a, b, out)
    np.testing.assert_array_equal(out, a * b + np.float32(0.5))
    assert counted.take() == {"mul": n, "add": n}


@compiled
def test_what_does_not_run_is_not_counted():
    counted = compile_counted(newton, (2.0,))
    for x in (2.0, 3.0, 1e9):
        steps = newton(x)
        assert counted.run(x) == steps
        assert counted.take() == {"div": steps, "add": steps, "mul": steps, "compare": steps}


@compiled
def test_roots_are_counted():
    a = np.linspace(1.0, 2.0, 100)
    counted = compile_counted(sum_of_roots, (a,))
    counted.run(a)
    assert counted.take() == {"sqrt": 100, "add": 100}


# The sources say more than the compiler leaves: it shares terms and drops what nothing reads. It adds some too: the lanes
# that only fill up the last vector of a patch's 289 points, comparisons for NaN, products in both branches of a selection.
LEAST, MOST = 0.6, 1.2


@compiled
def test_real_kernels_do_about_what_their_sources_say():
    shader = domain.shade_patches
    counts, sources = count_compiled(("cbox",)), costs.count_operations(1)
    assert domain.shade_patches is shader, "nothing is left behind"
    assert set(counts) == {"domain shader", "domain shader, map", "cbox"}
    for name, count in counts.items():
        assert LEAST < count.total / sources[name].total < MOST, name
        assert LEAST < count.arithmetic / sources[name].arithmetic < MOST, name
    assert counts["domain shader"].total < counts["domain shader, map"].total < counts["cbox"].total
    assert counts["cbox"].project > 0 == counts["cbox"].lookup


@compiled
def test_plain_kernels_are_left_alone():
    """What runs after a recording is not counted: no code of one kernel is taken for that of the other."""
    stage, recorder = costs.sample_patches(16, True), Recorder()
    with recorder.recording():
        counted = BOUNDS["cbox"](stage)
    assert sum(recorder.tally.values()) > 0
    plain = BOUNDS["cbox"](stage)
    assert all(kernel.take() == {} for kernel in recorder.kernels.values())
    for a, b in zip(counted, plain, strict=True):
        np.testing.assert_array_equal(a, b)


@compiled
@pytest.mark.slow
def test_compiled_counts_rise_in_the_papers_order():
    counts = count_compiled(("cbox", "obbtex", "tpatch", "npatch"))
    boxes = [counts[name].box for name in ("cbox", "obbtex", "tpatch", "npatch")]
    assert boxes == sorted(boxes)
    for name, (instructions, _) in costs.PAPER.items():
        assert 0.5 < counts[name].total / counts["domain shader, map"].total / instructions < 2, name
