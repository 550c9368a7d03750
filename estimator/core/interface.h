/* Made from interface.py by `python -m supply.core --header`. */
#ifndef DECKLANDER_INTERFACE_H
#define DECKLANDER_INTERFACE_H

#include <stdint.h>

#define ORDER_MAX 54
#define ROWS_MAX 9

/* core.c */
uint32_t core_digest(void);

/* kalman.c */
void kalman_predict(int32_t n, const double *P, const double *F, const double *Q, double *P_after);
int32_t kalman_correct(int32_t n, int32_t m, const double *P, const double *innov, const double *H, const double *R, double *dx, double *P_after, double *S, double *nis);

#ifndef INTERFACE_DIGEST
#define INTERFACE_DIGEST 1415976200u
#endif

#endif
