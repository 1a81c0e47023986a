from .budgets import (
    plot_noise_budget as plot_noise_budget,
)
from .figures import (
    COLORS as COLORS,
    plt as plt,
    save_figure as save_figure,
)
from .histories import (
    plot_time_history as plot_time_history,
)
from .inspection import (
    plot_inspection as plot_inspection,
)
from .loops import (
    plot_nyquist as plot_nyquist,
    plot_singular_values as plot_singular_values,
)
from .pareto import (
    plot_pareto as plot_pareto,
)
from .responses import (
    plot_frf as plot_frf,
    plot_frf_error as plot_frf_error,
    plot_modal_fit as plot_modal_fit,
)
from .root_loci import (
    plot_root_locus as plot_root_locus,
)
from .studies import (
    plot_scatter as plot_scatter,
    plot_sobol as plot_sobol,
    plot_tornado as plot_tornado,
)
