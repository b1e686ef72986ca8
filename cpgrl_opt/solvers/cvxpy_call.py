"""CVXPY asked for CLARABEL's answer without its warning of an inaccurate one, which the referee judges anyway."""

from typing import Any


def solve_statement(statement: Any, options: dict[str, Any]) -> Any:
    """CVXPY's Solution, unpacked into the variables of the Problem `statement`; cvxpy.SolverError if there is none.

    These are the steps of Problem.solve without its warnings: to switch those off would reach the whole process.
    """
    import cvxpy
    from cvxpy.settings import ERROR

    data, chain, inverse_data = statement.get_problem_data(cvxpy.CLARABEL, solver_opts=options)
    found = chain.solve_via_data(statement, data, warm_start=False, verbose=False, solver_opts=options)
    solution = chain.invert(found, inverse_data)
    if solution.status in ERROR:
        raise cvxpy.SolverError(f"CLARABEL failed with the status {solution.status}")
    statement.unpack(solution)
    return solution
